"""Methods of others on one window: GCC-PHAT, SRP-PHAT and MUSIC of pyroomacoustics, and SRP of our own, also whitened."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from av_audio.ego_noise import SHARES, NoiseRecording
from av_common.angles import direction_to_angles
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.trials import C, Found, Locate, Window

UPSAMPLING = 16  # of the plain GCC-PHAT
FULL_HZ = (100.0, 0.49)  # lower edge in Hz, upper edge as a share of the sample rate
WHITENED_HZ = (300.0, 7500.0)  # band of the whitened SRP
LENGTH = 1024  # of its transform
GRID_DEG = 1.0  # of azimuths


def gcc_phat(window: Window) -> Found:
    """The full-band GCC-PHAT of a pair, upsampled (Knapp and Carter, 1976)."""
    sound, rate, array, _ = window
    first, second = np.fft.rfft(sound.T, 2 * len(sound))
    cross = first * second.conj()
    correlation = np.fft.irfft(cross / np.maximum(np.abs(cross), 1e-12), UPSAMPLING * 2 * len(sound))
    reach = int(np.ceil(UPSAMPLING * rate * array.aperture / C))
    lags = np.arange(-reach, reach + 1)
    delay = -lags[np.argmax(correlation[lags])] / (UPSAMPLING * rate)
    return mirrored(array, folded(array, delay * C / array.aperture))


def of_library(method: str, window: Window) -> Found:
    """A method of pyroomacoustics in the full band, on a grid of one degree.

    Parameters:
        method: 'SRP' or 'MUSIC'.
        window: the sound.

    Raises ImportError without pyroomacoustics.
    """
    import pyroomacoustics
    sound, rate, array, _ = window
    algorithm = _algorithm(method, array.positions[:, :2].tobytes(), array.channels, rate)
    frames = pyroomacoustics.transform.stft.analysis(sound.astype(float), algorithm.nfft, algorithm.nfft // 2)
    algorithm.locate_sources(frames.transpose(2, 1, 0), num_src=1, freq_range=[FULL_HZ[0], FULL_HZ[1] * rate])
    azimuth = float(algorithm.azimuth_recon[0])
    return mirrored(array, folded(array, float(np.sin(azimuth))) if array.rank == 1 else azimuth)


PEERS: dict[str, Locate] = {'GCC-PHAT': gcc_phat, 'SRP-PHAT': partial(of_library, 'SRP'), 'MUSIC': partial(of_library, 'MUSIC')}


def mirrored(array: MicrophoneArray, azimuth: float) -> Found:
    """An azimuth (rad), of a pair with its mirror image, of a method that states no more."""
    return np.array([azimuth, np.pi - azimuth] if array.rank == 1 else [azimuth]), np.nan, 0.0


def folded(array: MicrophoneArray, q: float) -> float:
    """Azimuth in rad, -pi/2 to pi/2, of a measured projection q on the axis of a pair along y."""
    curve = array.delay_curve
    return float(np.arcsin(np.clip(q if curve is None else curve.true_cosine(q), -1.0, 1.0)))


@lru_cache(maxsize=8)
def _algorithm(method: str, places: bytes, channels: int, rate: int) -> Any:
    import pyroomacoustics
    return pyroomacoustics.doa.algorithms[method](
        np.frombuffer(places).reshape(channels, 2).T, rate, 512 if rate < 32_000 else 1024, c=C, num_src=1,
        azimuth=azimuths(channels))


def azimuths(channels: int) -> NDArray:
    """Azimuths in rad: a half circle for a pair, whose sides are mirror images."""
    return np.radians(np.arange(-90.0, 90.5, GRID_DEG) if channels == 2 else np.arange(-180.0, 180.0, GRID_DEG))


class Srp:
    """Steered response power with phase transform, of spectra that are whitened where the rig's own noise is known.

    The straightforward use of a recording (Okutani et al., 2012, with even weights): spectra and steering vectors of each bin
    are multiplied by R^-1/2.

    Parameters:
        array: the microphones.
        rate (Hz): sample rate.
        directions (g, 3): unit vectors among which to search.
        recording: of the rig alone; None whitens nothing.
    """

    def __init__(self, array: MicrophoneArray, rate: int, directions: NDArray, recording: NoiseRecording | None) -> None:
        self._rate, self._directions = rate, directions
        frequencies = np.fft.rfftfreq(LENGTH, 1.0 / rate)
        self._used = (frequencies >= WHITENED_HZ[0]) & (frequencies <= WHITENED_HZ[1])
        self._whitener = np.eye(array.channels)[None]
        if recording is not None:
            own = _covariance(self._spectra(recording.samples))
            power = np.einsum('kii->k', own).real / array.channels
            values, vectors = np.linalg.eigh(own + (SHARES[0] * power)[:, None, None] * np.eye(array.channels))
            self._whitener = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2)
        lead = array.positions @ directions.T / C
        steering = self._whitener @ np.exp(2j * np.pi * frequencies[self._used, None, None] * lead)
        self._steering = (steering / np.linalg.norm(steering, axis=1, keepdims=True)).astype(np.complex64)  # (k, m, g)

    def locate(self, window: Window) -> Found:
        """The direction of a window as a `Locate`."""
        return mirrored(window.array, float(direction_to_angles(self.direction(window.sound))[0]))

    def direction(self, sound: NDArray) -> NDArray:
        """Unit vector (3,) of a window (n, m)."""
        white = self._whitener @ self._spectra(sound)
        white = white / np.maximum(np.linalg.norm(white, axis=1, keepdims=True), 1e-30)
        turned = _covariance(white).astype(np.complex64) @ self._steering
        response = np.sum((self._steering.conj() * turned).real, axis=(0, 1))
        return np.asarray(self._directions[np.argmax(response)])

    def _spectra(self, sound: NDArray) -> NDArray:
        """Spectra (k, m, t) of sound (n, m)."""
        *_, spectra = signal.stft(sound.T, self._rate, nperseg=LENGTH)
        return np.asarray(spectra[:, self._used].swapaxes(0, 1))


def _covariance(spectra: NDArray) -> NDArray:
    """Covariances (k, m, m) of spectra (k, m, t)."""
    return np.asarray(spectra @ spectra.conj().swapaxes(1, 2) / spectra.shape[2])
