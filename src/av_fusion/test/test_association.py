"""Marginal association probabilities by belief propagation against the sum over all associations."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from av_fusion.tracks.association import associate


def exact(ratios, others):
    """Marginals (t, m + 1) by enumeration; the last column is a target without a measurement. Also those of no target (m,)."""
    targets, measurements = ratios.shape
    marginals, none, total = np.zeros((targets, measurements + 1)), np.zeros(measurements), 0.0
    for choice in product(range(measurements + 1), repeat=targets):
        taken = [j for j in choice if j < measurements]
        if len(set(taken)) < len(taken):
            continue
        weight = np.prod([ratios[t, j] for t, j in enumerate(choice) if j < measurements])
        weight *= np.prod([others[j] for j in range(measurements) if j not in taken])
        total += weight
        for t, j in enumerate(choice):
            marginals[t, j] += weight
        none[[j for j in range(measurements) if j not in taken]] += weight
    return marginals / total, none / total


def marginals_of(ratios, others):
    """The same by the code under test."""
    _, shares, unclaimed = associate(ratios, others)
    return np.hstack([shares, 1.0 - shares.sum(axis=1, keepdims=True)]), unclaimed


@pytest.mark.parametrize(('targets', 'measurements'), [(1, 1), (1, 4), (3, 1)])
def test_exact_without_loops(targets, measurements):
    """With one target or one measurement the graph is a tree, where belief propagation is exact."""
    random = np.random.default_rng(targets + 10 * measurements)
    ratios, others = random.lognormal(1.0, 2.0, (targets, measurements)), 1.0 + random.exponential(1.0, measurements)
    expected, none = exact(ratios, others)
    found, unexplained = marginals_of(ratios, others)
    assert np.allclose(found, expected, atol=1e-3)
    assert np.allclose(unexplained, none, atol=1e-3)


def test_close_with_loops():
    """Targets of which most prefer a measurement of their own: within 0.05 of the sum over all associations."""
    random = np.random.default_rng(4)
    for _ in range(20):
        ratios = random.lognormal(-1.0, 1.0, (3, 3)) + np.diag(random.lognormal(3.0, 1.0, 3))
        others = 1.0 + random.exponential(0.5, 3)
        expected, none = exact(ratios, others)
        found, unexplained = marginals_of(ratios, others)
        assert np.abs(found - expected).max() < 0.05
        assert np.abs(unexplained - none).max() < 0.05


def test_extreme_ratios_stay_finite():
    """Certain and impossible associations; every probability is in 0..1."""
    ratios = np.array([[1e12, 1e12, 0.0], [1e12, 1e12, 0.0], [0.0, 0.0, 0.0]])
    found, unexplained = marginals_of(ratios, np.ones(3))
    for probabilities in (found, unexplained):
        assert np.isfinite(probabilities).all() and probabilities.min() >= 0.0 and probabilities.max() <= 1.0
    assert np.allclose(found[:2, :2], 0.5, atol=0.01) and found[2, 3] == 1.0


def test_no_targets_and_no_measurements():
    """Empty tables are possible."""
    assert associate(np.zeros((0, 2)), np.ones(2)).unclaimed.tolist() == [1.0, 1.0]
    assert associate(np.zeros((2, 0)), np.ones(0)).free.shape == (2, 0)
