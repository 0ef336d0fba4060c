"""Motion of targets against the matrix exponential and its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from av_network import motion_model
from av_network.motion_model import (
    CLIMB_SHARE,
    MEMORY_SPEED,
    MODES,
    VELOCITY_MEMORY_S,
    Mode,
    axis_motion,
    changes,
    mixed,
    mixing,
    nearly_constant_velocity,
    singer,
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


@pytest.mark.parametrize('step', [0.005, 0.03, 0.25, 3.0])
def test_accelerations_last_for_a_time(step):
    """By the differential equations; back in time, the target returns to where it was."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -0.5]])
    F, Q = singer(np.array([step, -step]), 3.0, 2.0)
    for found, expected in zip((F[0], Q[0]), integrated(A, 3.0, step), strict=True):
        assert np.allclose(found, expected, rtol=5e-3, atol=1e-16)
    position, velocity, _ = F[1] @ F[0] @ np.array([5.0, 4.0, 0.0])
    assert position == pytest.approx(5.0) and velocity == pytest.approx(4.0)


def test_short_accelerations_are_white():
    """Then position and velocity move as with nearly constant velocity of the same spectral density."""
    found_both = singer(np.array([2.0]), 0.5 * 3.0 / 1e-3, 1e-3)
    for found, expected in zip(found_both, nearly_constant_velocity(np.array([2.0]), 3.0), strict=True):
        assert np.allclose(found[0, :2, :2], expected[0], rtol=5e-3, atol=1e-6)


@pytest.mark.parametrize('step', [0.2, 4.0])
@pytest.mark.parametrize('speed', [0.0, 2.0 * MEMORY_SPEED])
def test_velocities_are_forgotten_the_slower_the_faster_they_are(step, speed):
    """By the differential equations, in which the memory is five times as long at twice MEMORY_SPEED."""
    memory = VELOCITY_MEMORY_S * (1.0 if speed == 0.0 else 5.0)
    A = np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / memory, 1.0], [0.0, 0.0, -1.0 / 1.5]])
    found = axis_motion(np.array([step]), np.array([speed]), Mode(math.sqrt(2.0 / 3.0), 1.5, 1.0))
    F, Q = integrated(A, 2.0 / 1.5**2, step)
    assert np.allclose(found[0][0], F, rtol=0.02, atol=1e-9) and np.allclose(found[1][0], Q, rtol=0.02, atol=1e-9)


def test_uncertainty_stays_finite():
    """A long time leaves the stationary variance of the velocity, density * memory / 2 for short accelerations."""
    short = Mode(math.sqrt(15.0), 0.1, 1.0)
    variance = axis_motion(np.array([200.0]), np.zeros(1), short)[1][0, 1, 1]
    assert variance == pytest.approx(2.0 * 15.0 * 0.1 * VELOCITY_MEMORY_S / 2.0, rel=0.05)


def test_targets_move_less_in_height():
    """Each axis for itself, with the acceleration's standard deviation by CLIMB_SHARE, each target by its speed."""
    velocities = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    F, Q = (part[:, 1] for part in target_motion(0.4, np.stack([velocities, velocities], 1)))
    expected = axis_motion(np.full(2, 0.4), np.array([5.0, 0.0]), MODES[1])
    for axis, share in enumerate((1.0, 1.0, CLIMB_SHARE**2)):
        part = np.ix_([0, 1], [axis, axis + 3, axis + 6], [axis, axis + 3, axis + 6])
        assert np.allclose(F[part], expected[0]) and np.allclose(Q[part], share * expected[1])
    assert np.count_nonzero(F[0]) == 18 and np.count_nonzero(Q[0]) == 27
    assert math.isclose(F[1, 3, 3], math.exp(-0.4 / VELOCITY_MEMORY_S))


def test_modes_change_as_a_markov_chain_does(monkeypatch):
    """By the matrix exponential of the rates, each mode lasting for its duration on average."""
    monkeypatch.setattr(motion_model, 'MODES', (Mode(1.0, 1.0, 4.0), Mode(3.0, 1.0, 1.5)))
    rates = np.array([[-1.0 / 4.0, 1.0 / 4.0], [1.0 / 1.5, -1.0 / 1.5]])
    for step, found in zip((0.1, 2.0), changes(np.array([0.1, -2.0])), strict=True):
        assert np.allclose(found, expm(step * rates))


def test_moments_of_mixed_modes():
    """Against samples of what a target may have done before."""
    random = np.random.default_rng(4)
    weights, means = np.array([[0.7, 0.3]]), np.array([[[1.0, 0.0], [-2.0, 3.0]]])
    covariances = np.array([[np.diag([1.0, 0.5]), [[2.0, 0.6], [0.6, 1.0]]]])
    after, shares = mixing(weights, np.array([1.0]))
    found = mixed(shares, means, covariances)
    before = random.choice(2, 400_000, p=weights[0])
    steady = random.random(len(before)) < changes(np.array([1.0]))[0][before, 0]
    samples = np.stack([random.multivariate_normal(means[0, k], covariances[0, k], len(before)) for k in range(2)])
    drawn = samples[before, np.arange(len(before))]
    for mode, chosen in ((0, steady), (1, ~steady)):
        assert np.mean(chosen) == pytest.approx(after[0, mode], abs=0.005)
        assert np.allclose(np.mean(drawn[chosen], axis=0), found[0][0, mode], atol=0.03)
        assert np.allclose(np.cov(drawn[chosen].T), found[1][0, mode], atol=0.06)
