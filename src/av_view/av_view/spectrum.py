"""The spectrum of what is heard."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

BANDS = 48  # bars, 19 to a decade
LOWEST_HZ = 60.0  # below the blade pass of large drones
HIGHEST_HZ = 20_000.0  # the end of hearing
FLOOR_DB = -120.0  # below what 16 bits hold


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
