"""How far a drone is heard, and judged to be one, by its sound power, what else is to be heard, wind, and microphones."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from math import erf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from av_audio.drone_classifier import DroneClassifier, load_model
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise, Wind
from av_simulator.sound.source_signals import SourceSignal
from av_simulator.sound.stream import spl_to_pascal

SEED = 0  # of everything
RATE = 24_000  # Hz
TEMPERATURE_C, HUMIDITY_PERCENT = 20.0, 50.0  # of the air, which absorbs sound
POOL_S, HEARD_S, WINDOW_S = 12.0, 1.1, 0.5  # of sound that is rendered once; heard before a judgement; of a window
DISTANCES_M = 10.0 * 2.0 ** np.arange(0.0, 7.1, 0.5)  # 10 m to 1280 m
WITHIN_RAD, SHARE, WINDOWS = np.radians(5.0), 0.9, 20
ELEVATION_RAD = np.radians(20.0)  # of the drone
PAIR_RAD = np.radians(60.0)  # of azimuths from broadside at which a pair is tried
BAND_HZ, BINS = (100.0, 8000.0), 1024  # of the bound, and length of its transform
RING = 2.0 * np.pi * np.arange(8) / 8.0  # azimuths of eight microphones
ARRAYS = (
    MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), 'pair of 20 cm'),
    MicrophoneArray(0.07 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]), 'square of 14 cm'),
    MicrophoneArray(0.1 * np.stack([np.cos(RING), np.sin(RING), 0.0 * RING], axis=1), 'ring of 20 cm'))


class Place(NamedTuple):
    """What is heard besides: ambient level in dB(A) with the spectrum of traffic, and wind in m/s at foam windscreens."""

    name: str
    ambient_dba: float
    wind: float


PLACES = (Place('quiet field, calm', 30.0, 0.0), Place('quiet field, wind', 30.0, 5.0),
          Place('suburb, breeze', 45.0, 2.0), Place('street, breeze', 60.0, 2.0))


class Reach(NamedTuple):
    """Distances (m) in 90 % of windows of directions within 5 deg, of being judged a drone, and of the bound; 0 for none."""

    direction: float
    judged: float
    bound: float


class Scene:
    """A drone at any distance before one array at one place.

    Parameters:
        drone: its sound.
        place: what else is heard.
        array: the microphones.
    """

    def __init__(self, drone: SourceSignal, place: Place, array: MicrophoneArray) -> None:
        self._array, self._rng = array, np.random.default_rng(SEED)
        self._c, count = speed_of_sound(TEMPERATURE_C), round(POOL_S * RATE)
        self._drone = drone.stream(RATE, [SEED], lambda times: np.zeros((len(times), 3))).read(0, count)
        self._noise = _noise(place, array, self._c, count)
        settings = LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S, temperature_c=TEMPERATURE_C)
        model = load_model('')
        assert model is not None  # of the shipped one
        self._localizer, self._classifier = Localizer(array, RATE, settings), DroneClassifier(array, RATE, self._c, model)

    def reach(self) -> Reach:
        """The distances."""
        return Reach(_farthest(lambda distance: self._heard(distance)[0]), _farthest(lambda distance: self._heard(distance)[1]),
                     _farthest(self._bound))

    def _attenuated(self, distance: float, frequencies: NDArray) -> NDArray:
        """Gain (k,) of spherical spreading from 1 m and of the air (ISO 9613-1)."""
        loss = Medium(TEMPERATURE_C, HUMIDITY_PERCENT).absorption_db_per_m(frequencies)
        return np.asarray(10.0 ** (-0.05 * loss * distance) / distance)

    def _heard(self, distance: float) -> tuple[float, float]:
        """Shares of windows whose direction is within 5 deg, and whose log-odds of a drone are above 0."""
        rng, count, results = self._rng, round(HEARD_S * RATE), list[tuple[bool, bool]]()
        frequencies = np.fft.rfftfreq(count, 1.0 / RATE)
        for _ in range(WINDOWS):
            first, second = rng.integers(0, self._noise.shape[1] - count, 2)
            azimuth = float(rng.uniform(-1.0, 1.0) * (PAIR_RAD if self._array.rank == 1 else np.pi))
            lead = self._array.positions @ angles_to_direction(azimuth, ELEVATION_RAD) / self._c
            spectrum = np.fft.rfft(self._drone[first:first + count]) * self._attenuated(distance, frequencies)
            sound = np.fft.irfft(spectrum * np.exp(2j * np.pi * np.outer(lead, frequencies)), count, axis=1)
            sound = ((sound + self._noise[:, second:second + count]) / spl_to_pascal(120.0)).astype(np.float32).T
            estimate = self._localizer.process(sound[-round(WINDOW_S * RATE):], self._localizer.next_sample + count)[0]
            self._classifier.clear()
            self._classifier.add(sound)
            judged = self._classifier.judge([estimate.q])[0].probability if len(estimate.q) else 0.0
            # a pair hears the cone around its axis, on which the drone is
            truth = float(np.arcsin(np.sin(azimuth) * np.cos(ELEVATION_RAD))) if self._array.rank == 1 else azimuth
            results.append((bool(np.any(np.abs(wrap(estimate.azimuth - truth)) < WITHIN_RAD)), judged > 0.5))
        right, drones = np.array(results, dtype=float).mean(axis=0)
        return float(right), float(drones)

    def _bound(self, distance: float) -> float:
        """Probability that an error with the variance of the Cramer-Rao bound is within 5 deg, over azimuths.

        Of a Gaussian source with a known spectrum P in noise with covariance G, for a steering vector a with derivative d, it
        is the inverse of 2T times the integral of P r / (1 + r) (d'G^-1 d - |d'G^-1 a|^2 / a'G^-1 a), with r = P a'G^-1 a
        (Stoica and Nehorai, 1990).
        """
        frequencies = np.fft.rfftfreq(BINS, 1.0 / RATE)
        inside = (frequencies >= BAND_HZ[0]) & (frequencies <= BAND_HZ[1])
        power = _cross_spectra(self._drone[None])[inside, 0, 0].real * self._attenuated(distance, frequencies[inside]) ** 2
        inverse = np.linalg.inv(_cross_spectra(self._noise)[inside])
        omega, within = 2.0 * np.pi * frequencies[inside], []
        for azimuth in np.linspace(-1.0, 1.0, 24) * (PAIR_RAD if self._array.rank == 1 else np.pi):
            turned = [self._array.positions @ angles_to_direction(azimuth + step, 0.0) for step in (0.0, 1e-4)]
            a = np.exp(1j * np.outer(omega, turned[0]) / self._c)
            d = 1j * omega[:, None] * (turned[1] - turned[0]) / 1e-4 / self._c * a
            aa, dd, da = (np.einsum('ki,kij,kj->k', x.conj(), inverse, y) for x, y in ((a, a), (d, d), (d, a)))
            ratio = power * aa.real
            information = 2.0 * WINDOW_S * RATE / BINS * np.sum(
                power * ratio / (1.0 + ratio) * (dd.real - np.abs(da) ** 2 / aa.real))
            within.append(erf(WITHIN_RAD * float(np.sqrt(0.5 * information))))
        return float(np.mean(within))


def _noise(place: Place, array: MicrophoneArray, c: float, count: int) -> NDArray:
    """Pressure (m, n) in Pa at the microphones; the ambient part has the A-weighted level of the place."""
    def rendered(noise: Noise) -> NDArray:
        return noise.stream(RATE, array.positions, c, [SEED, 7]).read(0, count)
    ambient = rendered(Noise(self_noise_db_spl=None, urban_db_spl=60.0, urban_swing_db=0.0))
    weighted = np.fft.irfft(np.fft.rfft(ambient[0]) * _a_weight(np.fft.rfftfreq(count, 1.0 / RATE)), count)
    ambient *= spl_to_pascal(place.ambient_dba) / np.std(weighted)
    wind = Wind((place.wind, 0.0, 0.0)) if place.wind > 0.0 else None
    return ambient + rendered(Noise(wind=wind))


def _a_weight(frequencies: NDArray) -> NDArray:
    """Gain (k,) of the A-weighting (IEC 61672-1, annex E), 1 at 1 kHz."""
    f = np.square(frequencies)
    gain = 12194.0**2 * f**2 / ((f + 20.6**2) * np.sqrt((f + 107.7**2) * (f + 737.9**2)) * (f + 12194.0**2))
    return np.asarray(gain * 10.0 ** 0.1)


def _cross_spectra(samples: NDArray) -> NDArray:
    """Cross-spectra (k, m, m) of samples (m, n)."""
    return np.asarray(signal.csd(samples[None], samples[:, None], RATE, nperseg=BINS)[1].transpose(2, 0, 1))


def _farthest(share: Callable[[float], float]) -> float:
    """The largest of DISTANCES_M at which the share is reached, by bisection; 0 where it is not at the first."""
    reached = bisect_left(DISTANCES_M, True, key=lambda distance: share(float(distance)) < SHARE)
    return float(DISTANCES_M[reached - 1]) if reached else 0.0
