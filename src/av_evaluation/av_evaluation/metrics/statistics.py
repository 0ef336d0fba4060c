"""Statistics of errors: interval of the RMSE, effect size, and correlation of two distributions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

BLOCK_S = 2.0  # errors of successive windows are correlated: resampling them singly gives too short an interval
PERCENTILES = np.arange(1.0, 100.0)  # but for the ends, which are single errors
INTERVAL = 1.64  # standard deviations, within which are 90 % of Gaussian errors
LEVEL, RESAMPLES = 0.95, 2000  # of the interval: its probability, and the number of bootstrap samples


def rmse(errors: ArrayLike) -> float:
    """Root of the mean square of errors (n,); NaN of none."""
    return float(np.sqrt(np.mean(np.square(errors)))) if np.size(errors) else math.nan


def blocks_of(time: NDArray, values: NDArray) -> list[NDArray]:
    """Cut a series into blocks of BLOCK_S for `rmse_interval`.

    Parameters:
        time (n, s): increasing.
        values (n,): at these times.
    """
    if not len(time):
        return []
    cuts = np.flatnonzero(np.diff(np.floor((time - time[0]) / BLOCK_S))) + 1
    return np.split(values, cuts)


def rmse_interval(blocks: Sequence[NDArray]) -> tuple[float, float]:
    """Confidence interval of the RMSE by the block bootstrap (Kuensch, 1989), percentile method; nan for fewer than two blocks.

    Blocks of one value each make the ordinary bootstrap (Efron, 1979).

    Parameters:
        blocks: of errors, each drawn as a whole with replacement.
    """
    if len(blocks) < 2:
        return math.nan, math.nan
    sums = [np.sum(np.square(block)) for block in blocks], [len(block) for block in blocks]
    low, high = stats.bootstrap(
        sums, lambda squares, counts, axis: np.sqrt(squares.sum(axis) / counts.sum(axis)), paired=True, method='percentile',
        confidence_level=LEVEL, n_resamples=RESAMPLES, random_state=1).confidence_interval
    return float(low), float(high)


def cohens_d(one: ArrayLike, other: ArrayLike) -> float:
    """Difference of the means in pooled standard deviations (Cohen, 1988, eq. 2.5.1); nan for samples without spread.

    Parameters:
        one (n,): sample.
        other (m,): sample, whose mean is subtracted.
    """
    first, second = np.asarray(one, float), np.asarray(other, float)
    freedom = len(first) + len(second) - 2
    if min(len(first), len(second)) < 1 or freedom < 1:
        return math.nan
    squares = np.sum((first - first.mean()) ** 2) + np.sum((second - second.mean()) ** 2)
    return float((first.mean() - second.mean()) / np.sqrt(squares / freedom)) if squares > 0.0 else math.nan


def percentile_matched_correlation(one: ArrayLike, other: ArrayLike) -> float:
    """Pearson's correlation of the percentiles 1 to 99 of two samples; nan for samples without spread.

    It is 1 where one distribution is the other, shifted and scaled.

    Parameters:
        one (n,): sample.
        other (m,): sample, not paired with the first.
    """
    if min(np.size(one), np.size(other)) < 2:
        return math.nan
    matched = [np.percentile(np.asarray(sample, float), PERCENTILES) for sample in (one, other)]
    return float(stats.pearsonr(*matched).statistic) if min(map(np.ptp, matched)) > 0.0 else math.nan
