"""Statistics against what they must do in the long run."""

from __future__ import annotations

import numpy as np
import pytest

from av_evaluation.metrics.metrics import blocks_of, rmse, rmse_interval


def test_the_interval_of_single_values_is_that_of_the_normal_law():
    """The mean of the squares is normal by the central limit theorem."""
    values = np.random.default_rng(3).normal(5.0, 2.0, 400)
    low, high = np.square(rmse_interval(list(values[:, None])))
    half = 1.96 * np.std(values**2, ddof=1) / np.sqrt(len(values))
    assert (low, high) == pytest.approx((np.mean(values**2) - half, np.mean(values**2) + half), abs=0.15 * half)
    assert all(np.isnan(rmse_interval([values])))


def test_blocks_keep_the_interval_honest_where_errors_are_alike():
    """Each error repeated ten times adds no information: the interval must not shrink."""
    values = np.random.default_rng(4).normal(0.0, 1.0, 100)
    once = rmse_interval(list(values[:, None]))
    time = 0.2 * np.arange(1000)
    again = rmse_interval(blocks_of(time, np.repeat(values, 10)))
    single = rmse_interval(list(np.repeat(values, 10)[:, None]))
    width = [high - low for low, high in (once, again, single)]
    assert width[1] == pytest.approx(width[0], rel=0.15) and width[2] < 0.5 * width[0]
    assert rmse([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))


def test_blocks_hold_all_values_once():
    time = np.array([0.0, 0.5, 2.1, 2.2, 9.0])
    assert [list(block) for block in blocks_of(time, np.arange(5))] == [[0, 1], [2, 3], [4]]
    assert blocks_of(np.zeros(0), np.zeros(0)) == []
