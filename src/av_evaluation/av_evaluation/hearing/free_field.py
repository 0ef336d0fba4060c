"""Pairs and squares of microphones in the free field: accuracy, calibration of sigma, several sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from std_msgs.msg import Header

from av_audio.directions import angle_to_axis
from av_audio.drone_classifier import load_model
from av_audio.further_sources import MOST_SOURCES
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.stage import DoaStage
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_common.stamps import to_stamp
from av_evaluation.figures import Figure
from av_evaluation.hearing.places import pair
from av_evaluation.hearing.reach import ARRAYS
from av_evaluation.hearing.signals import BAND_HZ, RATE, Source, add_noise, flat, rotors

PAIR = pair(0.2)
SQUARE = MicrophoneArray(0.0325 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]), 'quadrotor_square')
C = speed_of_sound(20.0)
WINDOW_S = 0.5
FAR_OFF_DEG = 20.0
CONFIDENCE_THRESHOLD = 0.9  # the default confidence above which an estimate is used
SETTINGS = LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S)
APART, FOUND_DEG = 0.4, 10.0  # least distance of two sources, projected on the array; a direction with a larger error is false

Sources = dict[str, Source]
Maker = Callable[[Generator], tuple[NDArray, float]]  # sound (n, m) of a window, and the azimuth (rad) from which it comes


@dataclass(frozen=True)
class Trials:
    """Results of n independent windows.

    Parameters:
        error (n,) (deg): azimuth error of the closer mirror image.
        sigma (n,) (deg): estimated standard deviation.
        confidence (n,): confidence 0..1.
    """

    error: NDArray
    sigma: NDArray
    confidence: NDArray

    @classmethod
    def together(cls, parts: Sequence[Trials]) -> Trials:
        """The windows of several results."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in ('error', 'sigma', 'confidence')))

    @property
    def passed(self) -> NDArray:
        """Which windows (n,) exceed the default confidence."""
        return self.confidence >= CONFIDENCE_THRESHOLD

    @property
    def coverage(self) -> float:
        """Percentage of passed errors within 1.64 sigma, 90 by definition."""
        return 100.0 * float(np.mean(self.error[self.passed] <= 1.64 * self.sigma[self.passed]))


def trials(rng: Generator, make: Maker, count: int, array: MicrophoneArray = PAIR) -> Trials:
    """Results of independent windows.

    Parameters:
        rng: random numbers.
        make: a window of sound and its azimuth.
        count: number of windows.
        array: the microphones.
    """
    localizer, rows = Localizer(array, RATE, SETTINGS), list[tuple[float, float, float]]()
    for _ in range(count):
        sound, azimuth = make(rng)
        estimate, = localizer.process(sound, localizer.next_sample)
        rows.append((azimuth_error(estimate, azimuth), float(np.degrees(np.sqrt(estimate.azimuth_variance[0]))),
                     float(estimate.confidence[0])))
    return Trials(*np.array(rows).T)


def azimuth_error(estimate: DoaEstimate, azimuth: float) -> float:
    """Error in deg of the mirror image that is closest to the true azimuth in rad."""
    return float(np.degrees(np.min(np.abs(wrap(estimate.azimuth - azimuth)))))


def rms(values: NDArray) -> float:
    """Root of the mean square; NaN for none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float('nan')


def still(source: Source, snr_db: float, azimuths_deg: tuple[float, float] = (-180.0, 180.0)) -> Maker:
    """Plane waves of a source at an SNR in dB, from azimuths drawn uniformly from a range in deg."""
    def make(rng: Generator) -> tuple[NDArray, float]:
        azimuth = float(np.radians(rng.uniform(*azimuths_deg)))
        return add_noise(rng, source(rng, WINDOW_S, -PAIR.positions @ angles_to_direction(azimuth) / C), snr_db), azimuth
    return make


def accuracy(count: int, sources: Sources) -> Iterator[Figure]:
    """RMSE over the full circle with mirror images folded, and the Cramer-Rao bound.

    The limits apply to rotors, except to those with equal power per octave at -10 dB: there the bound itself, which assumes
    a known spectrum, is 3 degrees.
    """
    limits = {10.0: 0.6, 0.0: 1.0, -5.0: 2.0, -10.0: 4.0}
    for name, source in sources.items():
        for snr_db in (20.0, *limits):
            result = trials(np.random.default_rng(31), still(source, snr_db), count)
            limited = name == 'bright rotors' or (name == 'rotors' and snr_db > -10.0)
            yield Figure(f'{name}, {snr_db:+.0f} dB: RMSE of all estimates', rms(result.error), 'deg',
                         limits.get(snr_db) if limited else None)
            yield Figure(f'{name}, {snr_db:+.0f} dB: Cramer-Rao bound', bound_rms(source, snr_db, count), 'deg')
            yield Figure(f'{name}, {snr_db:+.0f} dB: median error', float(np.median(result.error)), 'deg')
            yield Figure(f'{name}, {snr_db:+.0f} dB: share above the default confidence', 100.0 * result.passed.mean(), '%')


def bound_rms(source: Source, snr_db: float, count: int) -> float:
    """RMSE in deg over the full circle of delays with the variance of the Cramer-Rao bound, converted to angles like ours.

    The bound is that of Gaussian sound with a known spectrum (Knapp and Carter, 1976, eq. 45); the spectrum is the
    periodogram of each window, averaged over three bins. At high SNR the few windows within a degree of the axis dominate
    both this value and that of the localizer.
    """
    rng = np.random.default_rng(36)
    frequencies = np.fft.rfftfreq(round(WINDOW_S * RATE), 1.0 / RATE)
    inside = (frequencies >= BAND_HZ[0]) & (frequencies <= BAND_HZ[1])
    omega = 2.0 * np.pi * frequencies[inside]
    errors = []
    for azimuth in np.pi * ((np.arange(count) + 0.5) / count - 0.5):
        power = np.abs(np.fft.rfft(source(rng, WINDOW_S, np.zeros(1))[:, 0])[inside]) ** 2
        snr = uniform_filter1d(power / power.mean(), 3) * 10.0 ** (snr_db / 10.0)
        sigma_q = C / PAIR.aperture / np.sqrt(2.0 * np.sum(omega**2 * snr**2 / (1.0 + 2.0 * snr)))
        angle, _ = angle_to_axis(np.sin(azimuth) + sigma_q * rng.normal(), sigma_q)
        errors.append(np.degrees(np.pi / 2.0 - angle - azimuth))
    return rms(np.array(errors))


def bound(count: int) -> Iterator[Figure]:
    """RMSE over the Cramer-Rao bound (Knapp and Carter, 1976) for a flat source at 30 to 150 degrees from the axis."""
    low, high = BAND_HZ
    for snr_db in (20.0, 10.0, 0.0):
        result = trials(np.random.default_rng(33), still(flat, snr_db, (-60.0, 60.0)), count)
        snr = 10.0 ** (snr_db / 10.0)
        delay = np.sqrt(3.0 * (1.0 + 2.0 * snr) / (8.0 * np.pi**2 * WINDOW_S * snr**2 * (high**3 - low**3)))
        bounds = C * delay / (PAIR.aperture * np.cos(np.radians(np.linspace(-60.0, 60.0, 1001))))
        yield Figure(f'flat source, {snr_db:+.0f} dB: RMSE over Cramer-Rao bound', rms(result.error) / np.degrees(rms(bounds)),
                     '', 1.3)


def sigma(count: int, sources: Sources) -> Iterator[Figure]:
    """Shares of errors within 1.64 sigma and of large errors, among estimates above the default confidence."""
    pooled = []
    for name, source in sources.items():
        for snr_db in (20.0, 10.0, 0.0, -5.0, -10.0):
            pooled.append(trials(np.random.default_rng(34), still(source, snr_db), count))
            yield Figure(f'{name}, {snr_db:+.0f} dB: errors within 1.64 sigma', pooled[-1].coverage, '%')
    everything = Trials.together(pooled)
    yield Figure('all sources, +20 to -10 dB: errors within 1.64 sigma', everything.coverage, '%', 97.0, 85.0)
    yield Figure('all sources, +20 to -10 dB: errors above 20 deg',
                 100.0 * np.mean(everything.error[everything.passed] > 20.0), '%', 1.0)
    for name, source in sources.items():
        result = trials(np.random.default_rng(35), still(source, -20.0), count)
        yield Figure(f'{name}, -20 dB: share above the default confidence', 100.0 * result.passed.mean(), '%', 2.0)


def square(count: int) -> Iterator[Figure]:
    """Four microphones: azimuths over the full circle, elevations from 0 to 60 degrees, sound of rotors at 10 dB."""
    rng, localizer, rows = np.random.default_rng(52), Localizer(SQUARE, RATE, SETTINGS), []
    for _ in range(count):
        azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(0.0, 60.0))
        window = add_noise(rng, rotors(rng, WINDOW_S, -SQUARE.positions @ angles_to_direction(azimuth, elevation) / C), 10.0)
        estimate, = localizer.process(window, localizer.next_sample)
        rows.append((azimuth_error(estimate, azimuth), np.degrees(estimate.elevation[0] - elevation),
                     len(estimate.azimuth), np.degrees(np.sqrt(estimate.azimuth_variance[0]))))
    azimuth_errors, elevation_errors, hypotheses, sigmas = np.array(rows).T
    yield Figure('square of 65 mm, +10 dB: azimuth RMSE', rms(azimuth_errors), 'deg', 2.0)
    yield Figure('square of 65 mm, +10 dB: elevation RMSE', rms(elevation_errors), 'deg', 5.0)
    yield Figure('square of 65 mm: hypotheses', hypotheses.max(), '', 1.0)
    yield Figure('square of 65 mm: azimuth errors within 1.64 sigma', 100.0 * np.mean(azimuth_errors < 1.64 * sigmas), '%')


def several(count: int, sources: Sources) -> Iterator[Figure]:
    """Shares found and false, RMSE and coverage, by array, number of sources and their level below the loudest."""
    for name, array in (('pair of 0.2 m', PAIR), ('square of 65 mm', SQUARE)):
        for number, below_db in ((1, 0.0), (2, 0.0), (2, 6.0), (2, 10.0), (3, 0.0)):
            yield from _several_figures(f'{name}, {number} sources, {0.0 - below_db:g} dB', array, number, below_db, count,
                                        list(sources.values()))


def cost(seconds: float = 10.0) -> Iterator[Figure]:
    """Processor time of the stage of doa_node as shipped, with two sources, for one thread with OMP_NUM_THREADS=1."""
    rng, settings = np.random.default_rng(72), LocalizerSettings()
    for array in ARRAYS:
        sound = sum((rotors(rng, seconds, -array.positions @ angles_to_direction(azimuth) / C) for azimuth in (-0.7, 0.5)),
                    np.zeros((round(seconds * RATE), array.channels)))
        stage, block = DoaStage(array, settings, drone_model=load_model('')), round(settings.hop_s * RATE)
        frames = [audio_frame(part.astype(np.float32), block * k, RATE, Header(stamp=to_stamp(1.0 + block * k / RATE)))
                  for k, part in enumerate(np.split(add_noise(rng, sound, 15.0), round(seconds * RATE / block)))]
        begun = process_time()
        for k, frame in enumerate(frames):
            stage.on_audio(frame, 1.0 + block * (k + 1) / RATE)
        yield Figure(f'{array.name}: of a core', 100.0 * (process_time() - begun) / seconds, '%')


def _several_figures(name: str, array: MicrophoneArray, number: int, below_db: float, count: int, sources: list[Source]
                     ) -> Iterator[Figure]:
    rng = np.random.default_rng(71)
    localizer = Localizer(array, RATE, LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S, max_sources=MOST_SOURCES))
    found, false = list[tuple[float, float]](), 0
    for _ in range(count):
        azimuths, sound = _azimuths(rng, array, number), np.zeros((round(WINDOW_S * RATE), array.channels))
        for k, azimuth in enumerate(azimuths):
            wave = sources[rng.integers(len(sources))](rng, WINDOW_S, -array.positions @ angles_to_direction(azimuth) / C)
            sound += wave / wave.std() * 10.0 ** (-(below_db if k else 0.0) / 20.0)
        estimate, = localizer.process(add_noise(rng, sound, 15.0), localizer.next_sample)
        assigned = _assigned(estimate, azimuths)
        false += len(estimate.sources) - len(assigned)
        found += assigned
    errors, sigmas = np.array(found).T
    yield Figure(f'{name}: found', 100.0 * len(errors) / (number * count), '%')
    yield Figure(f'{name}: false directions in a window', 100.0 * false / count, '%', 10.0)
    yield Figure(f'{name}: RMSE', rms(errors), 'deg')
    yield Figure(f'{name}: errors within 1.64 sigma', 100.0 * float(np.mean(errors < 1.64 * sigmas)), '%')


def _assigned(estimate: DoaEstimate, azimuths: NDArray) -> list[tuple[float, float]]:
    """Error and sigma in deg of the direction of each source at azimuths (s,) that is found, the strongest direction first."""
    left, found = list(azimuths), list[tuple[float, float]]()
    for source in estimate.sources:
        errors = [azimuth_error(source, azimuth) for azimuth in left]
        if errors and min(errors) < FOUND_DEG:
            left.pop(int(np.argmin(errors)))
            found.append((min(errors), float(np.degrees(np.sqrt(source.azimuth_variance[0])))))
    return found


def _azimuths(rng: Generator, array: MicrophoneArray, number: int) -> NDArray:
    """Random azimuths (number,) in rad of sources that are apart; for a pair up to 70 degrees from broadside."""
    largest = np.radians(70.0) if array.rank == 1 else np.pi
    while True:
        azimuths = rng.uniform(-largest, largest, number)
        places = angles_to_direction(azimuths) @ array.basis
        if all(np.linalg.norm(a - b) > APART for k, a in enumerate(places) for b in places[:k]):
            return azimuths
