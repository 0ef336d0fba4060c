"""Motion of targets against the matrix exponential and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from av_network import motion_model
from av_network.motion_model import (
    CLIMB_SHARE,
    MODES,
    VELOCITY_MEMORY_S,
    Mode,
    axis_motion,
    mixed,
    mixing,
    motion,
    target_motion,
)


def integrated(A, density, step):
    """Transition and covariance of dx = A x dt + dw, whose last element has noise, by their differential equations."""
    n = len(A)
    noise = np.zeros((n, n))
    noise[-1, -1] = density

    def rates(_, y):
        F, Q = y.reshape(2, n, n)
        return np.concatenate([(A @ F).ravel(), (A @ Q + Q @ A.T + noise).ravel()])

    begin = np.concatenate([np.eye(n).ravel(), np.zeros(n * n)])
    return solve_ivp(rates, (0.0, step), begin, method='DOP853', rtol=1e-11, atol=1e-16).y[:, -1].reshape(2, n, n)


@pytest.mark.parametrize('step', [0.005, 0.25, 3.0])
def test_accelerations_last_for_a_time_and_velocities_are_forgotten(step):
    """By the differential equations."""
    for mode, *found in zip(MODES, *(part[0] for part in axis_motion(np.array([step]))), strict=True):
        A = np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / VELOCITY_MEMORY_S, 1.0], [0.0, 0.0, -1.0 / mode.time]])
        for each, expected in zip(found, integrated(A, 2.0 * mode.sigma**2 / mode.time, step), strict=True):
            assert np.allclose(each, expected, rtol=1e-6, atol=1e-13)


def test_white_accelerations_are_those_of_nearly_constant_velocity():
    """By the textbook's matrices."""
    F, Q = motion(np.array([2.0]), np.array([[0.0, 1.0], [0.0, 0.0]]), 3.0)
    assert np.allclose(F[0], [[1.0, 2.0], [0.0, 1.0]]) and np.allclose(Q[0], 3.0 * np.array([[8.0 / 3.0, 2.0], [2.0, 2.0]]))


def test_targets_move_less_in_height():
    """Each axis for itself, with the acceleration's standard deviation by CLIMB_SHARE."""
    (F, Q), expected = target_motion(0.4), axis_motion(np.array([0.4]))
    for axis, share in enumerate((1.0, 1.0, CLIMB_SHARE**2)):
        part = np.ix_([0, 1], [axis, axis + 3, axis + 6], [axis, axis + 3, axis + 6])
        assert np.allclose(F[part], expected[0][0]) and np.allclose(Q[part], share * expected[1][0])
    assert np.count_nonzero(F[0]) == 18 and np.count_nonzero(Q[0]) == 27


def test_modes_change_as_a_markov_chain_does(monkeypatch):
    """By the matrix exponential of the rates, each mode lasting for its duration on average."""
    monkeypatch.setattr(motion_model, 'MODES', (Mode(1.0, 1.0, 4.0), Mode(3.0, 1.0, 1.5)))
    rates = np.array([[-1.0 / 4.0, 1.0 / 4.0], [1.0 / 1.5, -1.0 / 1.5]])
    for step in (0.1, 2.0):
        assert np.allclose(mixing(np.eye(2), np.full(2, step))[0], expm(step * rates))


def test_moments_of_mixed_modes():
    """Against samples of what a target may have done before."""
    random = np.random.default_rng(4)
    weights, means = np.array([[0.7, 0.3]]), np.array([[[1.0, 0.0], [-2.0, 3.0]]])
    covariances = np.array([[np.diag([1.0, 0.5]), [[2.0, 0.6], [0.6, 1.0]]]])
    after, shares = mixing(weights, np.array([1.0]))
    found = mixed(shares, means, covariances)
    before = random.choice(2, 400_000, p=weights[0])
    steady = random.random(len(before)) < mixing(np.eye(2), np.ones(2))[0][before, 0]
    samples = np.stack([random.multivariate_normal(means[0, k], covariances[0, k], len(before)) for k in range(2)])
    drawn = samples[before, np.arange(len(before))]
    for mode, chosen in ((0, steady), (1, ~steady)):
        assert np.mean(chosen) == pytest.approx(after[0, mode], abs=0.005)
        assert np.allclose(np.mean(drawn[chosen], axis=0), found[0][0, mode], atol=0.03)
        assert np.allclose(np.cov(drawn[chosen].T), found[1][0, mode], atol=0.06)
