"""Accuracy and calibration of sigma of two microphones in the free field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.directions import angle_to_axis
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.signals import BAND_HZ, RATE, Source, add_noise, flat, rotors

PAIR = MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), 'two_microphones')
WINDOW_S = 0.5
CONFIDENCE_THRESHOLD = 0.9  # the default confidence above which an estimate is used
FULL_CIRCLE = (-180.0, 180.0)


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

    @property
    def passed(self) -> NDArray:
        """Which windows (n,) exceed the default confidence."""
        return self.confidence >= CONFIDENCE_THRESHOLD


def azimuth_error(estimate: DoaEstimate, azimuth: float) -> float:
    """Error in deg of the mirror image that is closest to the true azimuth in rad."""
    return float(np.degrees(np.min(np.abs(wrap(estimate.azimuth - azimuth)))))


def trials(rng: Generator, source: Source, snr_db: float, count: int, azimuths_deg: tuple[float, float] = FULL_CIRCLE,
           method: str = 'ml') -> Trials:
    """Results of independent windows.

    Parameters:
        rng: random numbers.
        source: generates the sound.
        snr_db (dB): signal-to-noise ratio inside the band.
        count: number of windows.
        azimuths_deg (deg): range from which azimuths are drawn uniformly.
        method: estimator of the localizer.
    """
    localizer = Localizer(PAIR, RATE, LocalizerSettings(method=method, window_s=WINDOW_S, hop_s=WINDOW_S))
    rows: list[tuple[float, float, float]] = []
    for _ in range(count):
        azimuth = np.radians(rng.uniform(*azimuths_deg))
        delays = -PAIR.positions @ angles_to_direction(azimuth) / speed_of_sound(20.0)
        window = add_noise(rng, source(rng, WINDOW_S, delays), snr_db)
        estimate, = localizer.process(window, len(rows) * len(window))
        rows.append((azimuth_error(estimate, azimuth), float(np.degrees(np.sqrt(estimate.azimuth_variance[0]))),
                     float(estimate.confidence[0])))
    return Trials(*np.array(rows).T)


def accuracy(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """RMSE over the full circle with mirror images folded, and the Cramer-Rao bound.

    The limits apply to rotors, except to those with equal power per octave at -10 dB: there the bound itself, which assumes
    a known spectrum, is 3 degrees.

    Parameters:
        count: windows per figure.
        sources: generators of sound by name.
    """
    limits = {10.0: 0.6, 0.0: 1.0, -5.0: 2.0, -10.0: 4.0}
    for name, source in sources.items():
        for snr_db in (20.0, *limits):
            result = trials(np.random.default_rng(31), source, snr_db, count)
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
        information = 2.0 * np.sum(omega**2 * snr**2 / (1.0 + 2.0 * snr))
        sigma_q = speed_of_sound(20.0) / PAIR.aperture / np.sqrt(information)
        angle, _ = angle_to_axis(np.sin(azimuth) + sigma_q * rng.normal(), sigma_q)
        errors.append(np.degrees(np.pi / 2.0 - angle - azimuth))
    return rms(np.array(errors))


def methods(count: int) -> Iterator[Figure]:
    """RMSE and median error of all estimators on the sound of rotors."""
    for snr_db in (10.0, 0.0, -5.0, -10.0):
        for method in ('ml', 'phat', 'plain', 'music', 'mvdr'):
            result = trials(np.random.default_rng(32), rotors, snr_db, count, method=method)
            yield Figure(f'{method}, {snr_db:+.0f} dB: RMSE', rms(result.error), 'deg')
            yield Figure(f'{method}, {snr_db:+.0f} dB: median error', float(np.median(result.error)), 'deg')


def bound(count: int) -> Iterator[Figure]:
    """RMSE relative to the Cramer-Rao bound for a flat source at 30 to 150 degrees from the axis."""
    for snr_db in (20.0, 10.0, 0.0):
        rng = np.random.default_rng(33)
        result = trials(rng, flat, snr_db, count, (-60.0, 60.0))
        azimuths = np.radians(np.linspace(-60.0, 60.0, 1001))
        bounds = speed_of_sound(20.0) * cramer_rao_delay(snr_db) / (PAIR.aperture * np.cos(azimuths))
        yield Figure(f'flat source, {snr_db:+.0f} dB: RMSE over Cramer-Rao bound',
                     rms(result.error) / np.degrees(rms(bounds)), '', 1.3)


def cramer_rao_delay(snr_db: float) -> float:
    """Cramer-Rao bound of a delay's standard deviation in s: flat band, equal noise in both channels (Knapp, Carter, 1976)."""
    snr = 10.0 ** (snr_db / 10.0)
    low, high = BAND_HZ
    return float(np.sqrt(3.0 * (1.0 + 2.0 * snr) / (8.0 * np.pi**2 * WINDOW_S * snr**2 * (high**3 - low**3))))


def sigma(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """Shares of errors within 1.64 sigma and of large errors, among estimates above the default confidence."""
    pooled = []
    for name, source in sources.items():
        for snr_db in (20.0, 10.0, 0.0, -5.0, -10.0):
            result = trials(np.random.default_rng(34), source, snr_db, count)
            pooled.append(result)
            yield Figure(f'{name}, {snr_db:+.0f} dB: errors within 1.64 sigma', coverage(result), '%')
    everything = Trials(*(np.concatenate([getattr(result, field) for result in pooled])
                          for field in ('error', 'sigma', 'confidence')))
    yield Figure('all sources, +20 to -10 dB: errors within 1.64 sigma', coverage(everything), '%', 97.0, 85.0)
    yield Figure('all sources, +20 to -10 dB: errors above 20 deg',
                 100.0 * np.mean(everything.error[everything.passed] > 20.0), '%', 1.0)
    for name, source in sources.items():
        result = trials(np.random.default_rng(35), source, -20.0, count)
        yield Figure(f'{name}, -20 dB: share above the default confidence', 100.0 * result.passed.mean(), '%', 2.0)


def coverage(result: Trials) -> float:
    """Percentage of passed errors within 1.64 sigma."""
    return 100.0 * float(np.mean(result.error[result.passed] <= 1.64 * result.sigma[result.passed]))


def rms(values: NDArray) -> float:
    """Root of the mean square; NaN for none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float('nan')
