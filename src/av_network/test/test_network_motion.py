"""Motion of targets against the matrix exponential and its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from av_network.motion_model import axis_motion, nearly_constant_velocity, singer, target_motion
from av_network.settings import NetworkSettings


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
    for found, expected in zip(found_both, nearly_constant_velocity(2.0, 3.0), strict=True):
        assert np.allclose(found[0, :2, :2], expected, rtol=5e-3, atol=1e-6)


@pytest.mark.parametrize('step', [0.2, 4.0])
@pytest.mark.parametrize('speed', [0.0, 12.0])
def test_velocities_are_forgotten_the_slower_the_faster_they_are(step, speed):
    """By the differential equations, in which the memory of 8 s is five times as long at twice the settings' speed."""
    settings = NetworkSettings(manoeuvre=2.0, manoeuvre_time=1.5, velocity_memory=8.0, memory_speed=6.0)
    memory = 8.0 if speed == 0.0 else 40.0
    A = np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / memory, 1.0], [0.0, 0.0, -1.0 / 1.5]])
    found = axis_motion(np.array([step]), np.array([speed]), settings)
    F, Q = integrated(A, 2.0 / 1.5**2, step)
    assert np.allclose(found[0][0], F, rtol=0.02, atol=1e-9) and np.allclose(found[1][0], Q, rtol=0.02, atol=1e-9)


def test_uncertainty_stays_finite():
    """A long time leaves the stationary variance of the velocity, density * memory / 2 for short accelerations."""
    settings = NetworkSettings(manoeuvre=3.0, manoeuvre_time=0.1, velocity_memory=8.0)
    assert axis_motion(np.array([200.0]), np.zeros(1), settings)[1][0, 1, 1] == pytest.approx(12.0, rel=0.05)


def test_targets_move_less_in_height():
    """Each axis for itself, with the acceleration's standard deviation by `climb_share`, each target by its speed."""
    settings = NetworkSettings(climb_share=0.5)
    velocities = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    F, Q = target_motion(0.4, velocities, settings)
    expected = axis_motion(np.full(2, 0.4), np.array([5.0, 0.0]), settings)
    for axis, share in enumerate((1.0, 1.0, 0.25)):
        part = np.ix_([0, 1], [axis, axis + 3, axis + 6], [axis, axis + 3, axis + 6])
        assert np.allclose(F[part], expected[0]) and np.allclose(Q[part], share * expected[1])
    assert np.count_nonzero(F[0]) == 18 and np.count_nonzero(Q[0]) == 27
    assert math.isclose(F[1, 3, 3], math.exp(-0.4 / settings.velocity_memory))
