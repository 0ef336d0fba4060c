"""The spectrum of what is heard, in bands of equal ratio."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

BANDS = 48
LOWEST_HZ = 60.0
HIGHEST_HZ = 20_000.0
FLOOR_DB = -120.0


def spectrum(samples: ArrayLike, rate: float) -> NDArray[np.float64]:
    """Level in dB relative to full scale in each of BANDS bands from LOWEST_HZ to HIGHEST_HZ; FLOOR_DB above half the rate.

    Parameters:
        samples (n, channels): sound, full scale is -1 to 1.
        rate (Hz): of the samples.

    Raises ValueError for less than two samples or a rate that is not positive.
    """
    block = np.asarray(samples, float)
    if block.ndim != 2 or len(block) < 2 or not rate > 0.0:
        raise ValueError(f'{block.shape} samples at {rate} Hz have no spectrum')
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
