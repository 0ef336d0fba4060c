"""Comparison of sub-sample interpolations of a correlation peak."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from av_audio.localizer import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_evaluation.hearing.accuracy import PAIR, rms
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.signals import RATE, add_noise, flat

WINDOW_S = 0.5
LONGEST_S = 5e-4
SNR_DB = 40.0


def interpolation(count: int) -> Iterator[Figure]:
    """RMS error of the delay of a flat source at 40 dB, where the bias of the method dominates the noise."""
    rng = np.random.default_rng(71)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=WINDOW_S))
    errors: dict[str, list[float]] = {name: [] for name in (*PEAKS, 'Newton on the continuous function (ours)')}
    for _ in range(count):
        delay = rng.uniform(-LONGEST_S, LONGEST_S)
        window = add_noise(rng, flat(rng, WINDOW_S, np.array([0.0, delay])), SNR_DB)
        lags, correlation = correlate(window)
        best = int(np.argmax(correlation))
        for name, offset in PEAKS.items():
            errors[name].append(lags[best] + offset(*correlation[best - 1:best + 2]) / RATE - delay)
        estimate, = localizer.process(window, localizer.next_sample)
        found = estimate.q[0] * PAIR.aperture / speed_of_sound(20.0)
        errors['Newton on the continuous function (ours)'].append(found - delay)
    for name, values in errors.items():
        yield Figure(f'{name}: RMS error of the delay', 1e6 * rms(np.array(values)), 'us')


def correlate(window: NDArray) -> tuple[NDArray, NDArray]:
    """Lags in s and PHAT-weighted correlation of a window (n, 2), inside the band."""
    spectra = np.fft.rfft(window * np.hanning(len(window))[:, None], axis=0)
    cross = spectra[:, 1] * spectra[:, 0].conj()
    frequencies = np.fft.rfftfreq(len(window), 1.0 / RATE)
    low, high = LocalizerSettings().band_hz
    inside = (frequencies >= low) & (frequencies <= high)
    correlation = np.fft.fftshift(np.fft.irfft(np.where(inside, cross / np.maximum(np.abs(cross), 1e-30), 0.0)))
    reach = round(1.2 * LONGEST_S * RATE)
    lags = np.arange(-reach, reach + 1)
    return lags / RATE, correlation[len(correlation) // 2 + lags]


def parabola(left: float, middle: float, right: float) -> float:
    """Offset in samples of the vertex of the parabola through three points."""
    return 0.5 * (left - right) / (left - 2.0 * middle + right)


def cosine(left: float, middle: float, right: float) -> float:
    """Offset in samples of the maximum of the cosine through three points (Cespedes et al., 1995)."""
    turn = np.arccos(np.clip((left + right) / (2.0 * middle), -1.0, 1.0))
    return float(-np.arctan2(left - right, 2.0 * middle * np.sin(turn)) / turn) if turn > 0.0 else 0.0


PEAKS: dict[str, Callable[[float, float, float], float]] = {
    'nearest sample': lambda left, middle, right: 0.0, 'parabola through three samples': parabola,
    'cosine through three samples': cosine}
