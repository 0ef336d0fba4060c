"""Statistics of errors: how sure a figure is, how far two samples lie apart, and whether they are distributed alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

BLOCK_S = 2.0  # errors of successive windows are alike: resampling them singly would promise too much
PERCENTILES = np.arange(1.0, 100.0)


def rmse(errors: ArrayLike) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def blocks_of(time: NDArray, values: NDArray, length_s: float = BLOCK_S) -> list[NDArray]:
    """Values (n,) at rising times (n,) in s, cut into stretches of `length_s`."""
    if not len(time):
        return []
    cuts = np.flatnonzero(np.diff(np.floor((time - time[0]) / length_s))) + 1
    return np.split(values, cuts)


def rmse_interval(blocks: Sequence[NDArray], level: float = 0.95, resamples: int = 2000, seed: int = 1) -> tuple[float, float]:
    """Confidence interval of the RMSE by drawing whole blocks with replacement (Kuensch, 1989; percentile method).

    Blocks of one value each make the ordinary bootstrap (Efron, 1979). Returns nan for fewer than two blocks.
    """
    if len(blocks) < 2:
        return np.nan, np.nan
    squares, counts = np.array([np.sum(np.square(block)) for block in blocks]), np.array([len(block) for block in blocks])
    rows = np.random.default_rng(seed).integers(0, len(blocks), (resamples, len(blocks)))
    drawn = np.sqrt(squares[rows].sum(axis=1) / counts[rows].sum(axis=1))
    low, high = np.quantile(drawn, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)


def cohens_d(one: ArrayLike, other: ArrayLike) -> float:
    """Difference of the means in pooled standard deviations (Cohen, 1988, eq. 2.5.1); nan where there is no spread."""
    one, other = np.asarray(one, float), np.asarray(other, float)
    freedom = len(one) + len(other) - 2
    if min(len(one), len(other)) < 1 or freedom < 1:
        return np.nan
    squares = np.sum((one - one.mean()) ** 2) + np.sum((other - other.mean()) ** 2)
    return float((one.mean() - other.mean()) / np.sqrt(squares / freedom)) if squares > 0.0 else np.nan


def percentile_matched_correlation(one: ArrayLike, other: ArrayLike, percentiles: ArrayLike = PERCENTILES) -> float:
    """Pearson's r between the same percentiles of two samples, which need be neither paired nor equally long.

    It is 1 where one distribution is the other, shifted and scaled. Returns nan for samples without spread.
    """
    if min(np.size(one), np.size(other)) < 2:
        return np.nan
    matched = np.percentile(one, percentiles), np.percentile(other, percentiles)
    return float(stats.pearsonr(*matched).statistic) if min(np.ptp(quantiles) for quantiles in matched) > 0.0 else np.nan
