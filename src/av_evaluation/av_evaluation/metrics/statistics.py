"""Statistics of errors: the RMSE and its interval."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

BLOCK_S = 2.0  # errors of successive windows are correlated: resampling them singly gives too short an interval
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
