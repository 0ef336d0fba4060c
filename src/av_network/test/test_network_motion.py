"""Motion of targets against the matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from av_network.motion_model import forgotten_velocity, nearly_constant_velocity, target_motion
from av_network.settings import NetworkSettings


def van_loan(A, G, step):
    """Transition and covariance of dx = A x dt + dw, the density of w being G (Van Loan 1978)."""
    n = len(A)
    whole = expm(np.block([[-A, G], [np.zeros((n, n)), A.T]]) * step)
    F = whole[n:, n:].T
    return F, F @ whole[:n, n:]


@pytest.mark.parametrize('step', [1e-4, 0.005, 0.25, 3.0])
def test_velocity_is_forgotten(step):
    """By the differential equation; back in time the position returns, and the velocity is forgotten as well."""
    F, Q = van_loan(np.array([[0.0, 1.0], [0.0, -1.0 / 8.0]]), np.diag([0.0, 2.0]), step)
    found = forgotten_velocity(step, 2.0, 8.0)
    assert np.allclose(found[0], F, rtol=1e-6) and np.allclose(found[1], Q, rtol=2e-3, atol=0.0)
    assert np.allclose(forgotten_velocity(-step, 2.0, 8.0)[0], F * [[1.0, -1.0], [1.0, 1.0]], rtol=1e-6)


def test_a_long_memory_is_nearly_constant_velocity():
    """And a long time leaves the stationary variance of the velocity, density * memory / 2."""
    for found, expected in zip(forgotten_velocity(2.0, 3.0, 1e9), nearly_constant_velocity(2.0, 3.0), strict=True):
        assert np.allclose(found, expected)
    assert forgotten_velocity(200.0, 3.0, 8.0)[1][1, 1] == pytest.approx(12.0)


def test_targets_move_less_in_height():
    """Each axis for itself, with the acceleration's standard deviation by `climb_share`."""
    settings = NetworkSettings(manoeuvre=2.0, climb_share=0.5, velocity_memory=8.0)
    F, Q = target_motion(0.5, settings)
    for axis, density in enumerate((2.0, 2.0, 0.5)):
        part = np.ix_([axis, axis + 3], [axis, axis + 3])
        expected = forgotten_velocity(0.5, density, 8.0)
        assert np.allclose(F[part], expected[0]) and np.allclose(Q[part], expected[1])
    assert np.count_nonzero(F) == 9 and np.count_nonzero(Q) == 12
