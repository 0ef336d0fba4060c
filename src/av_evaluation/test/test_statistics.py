"""Statistics against textbook values, other code and what they must do in the long run."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from av_evaluation.metrics.statistics import blocks_of, cohens_d, percentile_matched_correlation, rmse, rmse_interval


def test_cohens_d_of_a_textbook_example():
    """Means 3 and 5, both of variance 2.5."""
    assert cohens_d([1, 2, 3, 4, 5], [3, 4, 5, 6, 7]) == pytest.approx(-2.0 / np.sqrt(2.5))
    assert np.isnan(cohens_d([1.0, 1.0], [1.0, 1.0])) and np.isnan(cohens_d([], [1.0]))


def test_cohens_d_is_the_t_statistic_without_the_sample_sizes():
    random = np.random.default_rng(1)
    one, other = random.normal(1.0, 2.0, 40), random.normal(0.0, 2.0, 70)
    t = stats.ttest_ind(one, other).statistic
    assert cohens_d(one, other) == pytest.approx(t * np.sqrt(1 / 40 + 1 / 70))


def test_percentile_matched_correlation_is_of_distributions_not_of_pairs():
    random = np.random.default_rng(2)
    sample = random.exponential(1.0, 5000)
    assert percentile_matched_correlation(sample, 3.0 * random.permutation(sample) + 2.0) == pytest.approx(1.0)
    other = random.uniform(0.0, 1.0, 300)
    grid = np.arange(1, 100) / 100
    expected = stats.pearsonr(-np.log1p(-grid), grid).statistic  # quantiles of the two laws
    assert percentile_matched_correlation(sample, other) == pytest.approx(expected, abs=0.03)
    assert np.isnan(percentile_matched_correlation([1.0], [1.0, 2.0]))
    assert np.isnan(percentile_matched_correlation([1.0, 1.0], [1.0, 2.0]))


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
