"""Features of the sound from one direction, by which a multirotor is told from other sources.

They do not depend on level and sample rate: powers count relative to their mean, and bins have a fixed width.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

FRAME_S, HOP_S = 0.256, 0.064  # length of a frame and time between frames; a bin is 1 / FRAME_S wide
SEGMENT_FRAMES = 12  # of which features are computed: one second
LOWEST_HZ, HIGHEST_HZ = 62.5, 7500.0
BANDS = 24  # evenly spaced in mel
# Spectral lines stand out from the median over this width: 200 Hz.
FLOOR_BINS, LARGEST_PROMINENCE = round(200.0 * FRAME_S) | 1, 5.0
# Powers of a direction below this share of the power at a microphone are other directions' remains.
LEAST_SHARE = 0.05
FUNDAMENTALS_HZ = (45.0, 900.0)  # of combs: blade passing frequencies, and those of voices and engines
LOG_STEP = 0.01  # of the logarithmic frequency axis on which combs are searched
ORDERS = 12  # harmonics of a comb
NEIGHBOURS = (3, 6, 10, 16)  # steps from the best fundamental, at which the combs of other rotors may lie
SHIFTS = 8  # largest change of the fundamental within a segment, in steps
LEAST_PROMINENCE = 1.5  # of a line, as opposed to a chance maximum
TONE_BINS = 5  # over which a line of rotors with different speeds extends
LINE_BANDS_HZ = (62.5, 300.0, 800.0, 1600.0, 3200.0, 7500.0)  # edges of the bands in which lines are counted
# The comb of a shaft's frequency has lines of imbalance between those of the blades. A multiple is the blade-pass frequency
# where the strongest line between its harmonics has less than this ratio of the strongest harmonic's power. For twice it is
# smaller: reflections may weaken every second line of a true comb.
LARGEST_BETWEEN = {2: 0.06, 3: 0.2, 4: 0.2, 5: 0.2, 6: 0.2}
LEAST_COMB = 0.5  # by which the lines of a comb stand out from what is between them; of noise it is up to 0.4
COMB_STEPS = 5  # over which the lines of rotors with different speeds spread
FUNDAMENTAL_SIGMA = 0.03  # relative error of fundamentals: the rotors of one drone differ
LINES, LINE_CELLS = 4, int(np.log(HIGHEST_HZ / LOWEST_HZ) / LOG_STEP)  # rows of `lines`, and their cells from LOWEST_HZ on
MOVED_FROM = 150  # first of the cells by which movement is measured: they are not narrower than half a bin
SPACINGS_HZ = (20.0, 40.0, 60.0, 90.0, 130.0, 180.0, 250.0, 350.0, 500.0, 700.0)  # distances between lines


@dataclass(frozen=True)
class Segment:
    """Spectra of one second of the sound from a direction.

    Parameters:
        power (t, k): estimated power from the direction by frame and bin; may be negative where other sources are stronger.
        total (t, k): mean power at the microphones, positive.
    """

    power: NDArray
    total: NDArray

    @cached_property
    def prominence(self) -> NDArray[np.float32]:
        """How much each bin (k,) stands out from its surroundings; see `prominence_of`."""
        return prominence_of(self.power, self.total)


def bin_frequencies() -> NDArray:
    """Frequencies (k,) in Hz of the bins of a `Segment`."""
    return np.arange(round(LOWEST_HZ * FRAME_S), round(HIGHEST_HZ * FRAME_S) + 1) / FRAME_S


class DroneFeatures:
    """Computes the features of segments.

    - *bands*: mean level of each mel band relative to all, its standard deviation and its mean change over time. Rotors are
      steady and broad, voices and birds are not.
    - *combs*: how much the harmonics of the best fundamental stand out, its frequency, the orders, and how wide it is:
      several rotors have similar but different speeds. How much the lines move within the second, and how well they remain.
    - *lines*: share and prominence of spectral lines in five bands.
    - *spacings*: autocorrelation of the lines over frequency, by distance.
    """

    COUNT = 102  # features of a segment

    def __init__(self) -> None:
        self._frequencies = frequencies = bin_frequencies()
        self._bands = _mel_filters(frequencies)
        count = int(np.log(frequencies[-1] / FUNDAMENTALS_HZ[0]) / LOG_STEP)
        axis, self._cells = _log_axis(frequencies, FUNDAMENTALS_HZ[0], count)
        _, self._line_cells = _log_axis(frequencies, LOWEST_HZ, LINE_CELLS)
        self._fundamentals = axis[axis <= FUNDAMENTALS_HZ[1]]
        self._combs, self._gaps = _combs(len(self._fundamentals), count)
        self._line_bands = np.searchsorted(frequencies, LINE_BANDS_HZ)
        self._lags = np.unique(np.round(np.array(SPACINGS_HZ) * FRAME_S).astype(int))

    def __call__(self, segment: Segment) -> NDArray[np.float32]:
        """Features (n,) of a segment."""
        bands = self._band_features(segment)
        whole, halves = segment.prominence, zip(np.array_split(segment.power, 2), np.array_split(segment.total, 2), strict=True)
        combs = self._comb_features(whole, *(prominence_of(power, total) for power, total in halves))
        return np.concatenate([bands, combs, self._line_features(whole), self._spacings(whole)]).astype(np.float32)

    def lines(self, segment: Segment) -> NDArray[np.float32]:
        """Lines (LINES, LINE_CELLS) by log frequency: of the second, coherence, mean of frames, mean of moved frames.

        Each frame is moved to where it agrees best with the mean of those before. Lines of one shaft move together, and are
        sharper thereafter; those of several rotors are not.
        """
        level = np.log(np.maximum(segment.power, LEAST_SHARE * segment.total.mean(axis=0)) + 1e-20)
        frames = np.clip(level - floor_of(level.mean(axis=0)), 0.0, LARGEST_PROMINENCE)
        coherence = np.clip(segment.power.sum(axis=0) / (segment.total.sum(axis=0) + 1e-20), 0.0, 1.0)
        cells = _largest(np.vstack([segment.prominence, coherence, frames]), self._line_cells)
        frames = cells[2:]
        padded = np.pad(frames, ((0, 0), (SHIFTS, SHIFTS)))
        moved = frames[0].copy()
        for number in range(1, len(frames)):
            parts = sliding_window_view(padded[number], LINE_CELLS)
            best = int(np.argmax(parts[:, MOVED_FROM:] @ moved[MOVED_FROM:]))
            moved += parts[best]
        return np.stack([cells[0], cells[1], frames.mean(axis=0), moved / len(frames)]).astype(np.float32)

    def fundamental(self, segment: Segment) -> float:
        """Fundamental (Hz) of the harmonics, which is the blade-pass frequency of a drone; NaN where none stand out."""
        lines = uniform_filter1d(_largest(segment.prominence, self._cells), COMB_STEPS)
        scores = self._combs @ lines - self._gaps @ lines
        if scores.max() < LEAST_COMB:
            return float('nan')
        found = float(self._fundamentals[int(np.argmax(scores))])
        tones = np.where(segment.prominence > LEAST_PROMINENCE, segment.power.mean(axis=0), 0.0)
        tones = maximum_filter1d(np.maximum(tones, 0.0), TONE_BINS)
        multiple = self._multiple(tones, found)
        return multiple * found if multiple * found <= FUNDAMENTALS_HZ[1] else found

    def _multiple(self, tones: NDArray, fundamental: float) -> int:
        """The largest multiple of a fundamental (Hz) between whose harmonics there is hardly any power (k,); 1 for none."""
        orders = np.arange(1, int(HIGHEST_HZ / fundamental) + 1)
        bins = np.round(orders * fundamental * FRAME_S).astype(int) - round(self._frequencies[0] * FRAME_S)
        powers = np.where(bins < 0, 0.0, tones[np.maximum(bins, 0)])
        return max((k for k, ratio in LARGEST_BETWEEN.items()
                    if powers[orders % k > 0].max() < ratio * powers[orders % k == 0].max(initial=0.0)), default=1)

    def _band_features(self, segment: Segment) -> NDArray:
        power, total = segment.power @ self._bands.T, segment.total @ self._bands.T
        level = np.log(np.maximum(power, LEAST_SHARE * total) + 1e-20)  # (t, bands)
        mean = level.mean(axis=0)
        change = np.abs(np.diff(level, axis=0)).mean(axis=0)
        overall = np.log(np.maximum(power.sum(axis=1), LEAST_SHARE * total.sum(axis=1)) + 1e-20)
        share = np.maximum(power.sum(), 0.0) / (total.sum() + 1e-20)
        return np.concatenate([mean - mean.mean(), level.std(axis=0), change[::3], [overall.std(), np.ptp(overall), share]])

    def _comb_features(self, whole: NDArray, first: NDArray, second: NDArray) -> NDArray:
        lines = _largest(whole, self._cells)
        combs = self._combs @ lines
        scores = combs - self._gaps @ lines
        best = int(np.argmax(scores))
        orders = np.round(np.log(np.arange(1, 9)) / LOG_STEP).astype(int) + best
        near = maximum_filter1d(lines, 3)
        harmonics = np.where(orders < len(lines), near[np.minimum(orders, len(lines) - 1)], 0.0)
        around = [max(scores[max(best - step, 0)], scores[min(best + step, len(scores) - 1)]) for step in NEIGHBOURS]
        apart = np.abs(np.arange(len(scores)) - best)
        other = float(np.max(scores[apart > 2 * NEIGHBOURS[-1]]))
        before, after = _largest(first, self._cells), _largest(second, self._cells)
        shifted = _correlations(before[SHIFTS:-SHIFTS], after)
        return np.concatenate([[scores[best], combs[best], np.log(self._fundamentals[best]), other], harmonics, around,
                               [shifted.max(), shifted[SHIFTS], float(np.argmax(shifted) - SHIFTS)]])

    def _line_features(self, prominence: NDArray) -> NDArray:
        parts = np.split(prominence, self._line_bands[1:-1])
        return np.array([value for part in parts for value in ((part > 1.5).mean(), part.mean(), np.sort(part)[-5:].mean())])

    def _spacings(self, prominence: NDArray) -> NDArray:
        low = prominence[:len(prominence) // 2] - prominence[:len(prominence) // 2].mean()
        size = fft.next_fast_len(2 * len(low), real=True)
        correlation = fft.irfft(np.abs(fft.rfft(low, size)) ** 2, size)
        correlation /= max(correlation[0], 1e-9)
        return np.maximum.reduceat(correlation[:self._lags[-1]], self._lags[:-1])


def prominence_of(power: NDArray, total: NDArray) -> NDArray[np.float32]:
    """How much each bin (k,) stands out from its surroundings, as the logarithm of a ratio of powers, from 0.

    Parameters:
        power, total (t, k): see `Segment`.
    """
    least = LEAST_SHARE * total.mean(axis=0)
    level = np.log(np.maximum(power.mean(axis=0), least) + 1e-20)
    return np.clip(level - floor_of(level), 0.0, LARGEST_PROMINENCE).astype(np.float32)


def floor_of(level: NDArray) -> NDArray:
    """Levels (k,) of what is between the lines of levels (k,)."""
    coarse = median_filter(level[::4], FLOOR_BINS // 4, mode='nearest')
    return np.interp(np.arange(len(level)), np.arange(0, len(level), 4), coarse)


def _log_axis(frequencies: NDArray, lowest: float, count: int) -> tuple[NDArray, NDArray]:
    """Frequencies (count,) of a logarithmic axis, and the first bin of each of its cells and the one after the last (count, 2).

    Parameters:
        frequencies (k,) (Hz): of the bins.
        lowest (Hz): of the axis, whose step is LOG_STEP.
        count: number of cells.
    """
    axis = lowest * np.exp(LOG_STEP * np.arange(count))
    below, above = (np.searchsorted(frequencies, axis * np.exp(side * LOG_STEP)) for side in (-0.5, 0.5))
    return axis, np.clip(np.stack([below, np.maximum(above, below + 1)], axis=1), 0, len(frequencies) - 1)


def _largest(values: NDArray, cells: NDArray) -> NDArray:
    """The largest of values (..., k) within each cell; see `_log_axis`."""
    return np.asarray(np.maximum.reduceat(values, cells.ravel(), axis=-1)[..., ::2])


def _correlations(part: NDArray, whole: NDArray) -> NDArray:
    """Correlation coefficients (w - n + 1,) of values (n,) with all parts of others (w,)."""
    parts = sliding_window_view(whole, len(part))
    parts, part = parts - parts.mean(axis=1, keepdims=True), part - part.mean()
    return parts @ part / np.maximum(np.sqrt(np.sum(parts**2, axis=1) * (part @ part)), 1e-9)


def _combs(fundamentals: int, count: int) -> tuple[NDArray, NDArray]:
    """Matrices (fundamentals, count): mean over the harmonics of each fundamental, and over the middles between them."""
    combs, gaps = (np.zeros((fundamentals, count), np.float32) for _ in range(2))
    for matrix, offset in ((combs, 0.0), (gaps, 0.5)):
        steps = np.round(np.log(np.arange(1, ORDERS + 1) + offset) / LOG_STEP).astype(int)
        for row in range(fundamentals):
            inside = steps[row + steps < count] + row
            matrix[row, inside] = 1.0 / len(inside)
    return combs, gaps


def _mel_filters(frequencies: NDArray) -> NDArray:
    """Triangular filters (BANDS, k) of equal width in mel (O'Shaughnessy, 1987)."""
    low, high = (2595.0 * np.log10(1.0 + f / 700.0) for f in (LOWEST_HZ, HIGHEST_HZ))
    centres = 700.0 * (10.0 ** (np.linspace(low, high, BANDS + 2) / 2595.0) - 1.0)
    rise = (frequencies - centres[:-2, None]) / np.diff(centres)[:-1, None]
    fall = (centres[2:, None] - frequencies) / np.diff(centres)[1:, None]
    filters = np.clip(np.minimum(rise, fall), 0.0, None)
    return filters / np.maximum(filters.sum(axis=1, keepdims=True), 1e-9)
