"""The spectrum of what is heard, and its signal-to-noise ratio, by what the microphones have in common."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

BANDS = 48  # bars, 19 to a decade
LOWEST_HZ = 60.0  # below the blade pass of large drones
HIGHEST_HZ = 20_000.0  # the end of hearing
FLOOR_DB = -120.0  # below what 16 bits hold
SEGMENT = 256  # samples
BAND_HZ = 500.0, 8000.0  # below, noise of the surroundings is common to close microphones, too
MEMORY_S = 2.0  # four windows of doa_node


def spectrum(samples: ArrayLike, rate: float) -> NDArray[np.float64]:
    """Level in dB relative to full scale in each of BANDS bands from LOWEST_HZ to HIGHEST_HZ; FLOOR_DB above half the rate.

    Parameters:
        samples (n, channels): sound, full scale is -1 to 1.
        rate (Hz): of the samples.

    Raises ValueError for less than three samples, samples that are no numbers, or a rate that is not positive.
    """
    block = np.asarray(samples, float)
    if block.ndim != 2 or len(block) < 3 or not (rate > 0.0 and np.isfinite(block).all()):    # a window of two is of zeros
        raise ValueError(f'{block.shape} samples at {rate} Hz, some of which may be no numbers, have no spectrum')
    window = np.hanning(len(block))
    lines = np.fft.rfft(block * window[:, None], axis=0)
    power = np.square(np.abs(lines)).mean(axis=1) * 2.0 / (np.square(window).sum() * len(block))  # by Parseval, one-sided
    frequencies = np.fft.rfftfreq(len(block), 1.0 / rate)
    edges = np.geomspace(LOWEST_HZ, HIGHEST_HZ, BANDS + 1)
    # A narrow band between two lines has the power of the nearest line, by its share of the line's width.
    total = np.concatenate([[0.0], np.cumsum(power)])
    upper = np.concatenate([[0.0], frequencies + 0.5 * frequencies[1]])
    inside = np.diff(np.interp(edges, upper, total))
    return np.where(edges[1:] <= 0.5 * rate, 10.0 * np.log10(inside + 10.0 ** (0.1 * FLOOR_DB)), FLOOR_DB)


class Coherence:
    """Cross-spectra of neighbouring channels, averaged over MEMORY_S.

    Of two microphones that hear one source and independent noise of equal power, the modulus of the coherence is
    SNR / (1 + SNR): Carter, Coherence and time delay estimation, Proc. IEEE 75(2), 1987.
    """

    def __init__(self) -> None:
        self._common: NDArray[np.complex128] | None = None  # (pairs, lines)
        self._power: NDArray[np.float64] | None = None

    def add(self, samples: ArrayLike, rate: float, since: float) -> float:
        """The signal-to-noise ratio (dB) after a block of sound; nan for less than two channels.

        Parameters:
            samples (n, channels): the block.
            rate (Hz): of the samples.
            since (s): time since the block before.
        """
        block = np.asarray(samples, float)
        if block.ndim != 2 or block.shape[1] < 2 or len(block) < SEGMENT or not rate > 0.0:
            return math.nan
        segments = sliding_window_view(block, SEGMENT, axis=0)[::SEGMENT // 2] * np.hanning(SEGMENT)  # (n, channels, samples)
        frequencies = np.fft.rfftfreq(SEGMENT, 1.0 / rate)
        lines = np.fft.rfft(segments)[..., (frequencies >= BAND_HZ[0]) & (frequencies <= BAND_HZ[1])]
        common = (lines[:, 1:] * lines[:, :-1].conj()).mean(axis=0)
        powers = np.square(np.abs(lines)).mean(axis=0)
        power = np.sqrt(powers[1:] * powers[:-1])
        if self._common is None or self._power is None or self._common.shape != common.shape:
            self._common, self._power = common, power
        kept = math.exp(-max(since, 0.0) / MEMORY_S)
        self._common = kept * self._common + (1.0 - kept) * common
        self._power = kept * self._power + (1.0 - kept) * power
        total, shared = float(self._power.sum()), float(np.abs(self._common).sum())
        noise = max(total - shared, 1e-6 * total)
        return 10.0 * math.log10(max(shared, 1e-6 * total) / noise) if total > 0.0 else math.nan
