"""The joint filter of targets, headings and clocks, and what it is made of, against independent calculations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from av_network.apparent_direction import apparent_directions
from av_network.decorrelation import Decorrelation, correlation_time
from av_network.joint_filter import JointFilter, Observation
from av_network.report import Report, Sighting
from av_network.settings import NetworkSettings, RigSettings

SOUND = 343.2


def sighting(azimuth, elevation, sigma=0.01, **values):
    return Sighting(1, azimuth, elevation, np.eye(2) * sigma**2, values.pop('measured', 1.0), **values)


@pytest.mark.parametrize('speed', [SOUND, math.inf])
def test_apparent_direction_is_that_at_the_time_of_emission(speed):
    """The time of emission by a root finder, and derivatives by differences."""
    position, velocity, origin = np.array([30.0, 80.0, 25.0]), np.array([-18.0, 9.0, 3.0]), np.array([2.0, -1.0, 1.5])

    def angles(p, v, ahead):
        def late(t):
            return speed * (ahead - t) - np.linalg.norm(p + v * t - origin)
        emitted = ahead if math.isinf(speed) else brentq(late, ahead - 2.0, ahead)
        d = p + v * emitted - origin
        return np.array([math.atan2(d[1], d[0]), math.atan2(d[2], math.hypot(d[0], d[1]))])

    found = apparent_directions(position[None], velocity[None], origin, np.array([0.2]), np.array([speed]))
    expected = angles(position, velocity, 0.2)
    assert np.allclose([found.azimuth[0], found.elevation[0]], expected, atol=1e-9)
    level = np.array([math.cos(expected[1]), 1.0])
    step = 1e-5
    for axis in range(3):
        shift = np.eye(3)[axis] * step
        by_position = level * (angles(position + shift, velocity, 0.2) - angles(position - shift, velocity, 0.2)) / (2 * step)
        by_velocity = level * (angles(position, velocity + shift, 0.2) - angles(position, velocity - shift, 0.2)) / (2 * step)
        assert np.allclose(found.by_position[0, :, axis], by_position, atol=1e-7)
        assert np.allclose(found.by_velocity[0, :, axis], by_velocity, atol=1e-7)
    by_time = level * (angles(position, velocity, 0.2 + step) - angles(position, velocity, 0.2 - step)) / (2 * step)
    assert np.allclose(found.by_time[0], by_time, atol=1e-7)


def test_information_of_correlated_reports_is_that_of_least_squares():
    """A constant from samples of a first-order Gauss-Markov error: the variance by generalised least squares."""
    variance, density, interval, count = 1e-3, 0.001, 0.25, 12
    rho = math.exp(-interval / correlation_time(variance, density))
    covariance = variance * rho ** np.abs(np.subtract.outer(range(count), range(count)))
    information = np.linalg.inv(covariance).sum()
    decorrelation, found = Decorrelation(density), 0.0
    for k in range(count):
        one = Sighting(7, 0.3, 0.1, np.eye(2) * variance, 10.0 + k * interval)
        ((_, new),) = decorrelation.fresh(Report('a', 10.0 + k * interval, np.zeros(3), (one,)))
        found += 1.0 / new[0, 0]
    assert found == pytest.approx(information, rel=1e-9)


def test_correlation_time_is_that_of_a_filter_in_its_steady_state():
    """The filter's error has the integral of its autocorrelation that the closed form says."""
    density, sigma, step = 0.001, 0.05, 0.01
    F, Q = np.array([[1.0, step], [0.0, 1.0]]), density * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    P = np.eye(2)
    for _ in range(5000):
        P = F @ P @ F.T + Q
        gain = P[:, 0] / (P[0, 0] + sigma**2)
        P = P - np.outer(gain, P[0])
    closed = sigma**2 * step / (2.0 * P[0, 0])  # half of the spectral density at 0 over the variance
    assert correlation_time(float(P[0, 0]), density) == pytest.approx(closed, rel=0.05)


def test_a_prediction_carries_no_information():
    """The same capture time again, and an earlier report."""
    decorrelation = Decorrelation(0.001)
    assert decorrelation.fresh(Report('a', 5.0, np.zeros(3), (sighting(0.1, 0.2, measured=4.9),)))
    assert not decorrelation.fresh(Report('a', 5.3, np.zeros(3), (sighting(0.1, 0.2, measured=4.9),)))
    assert not decorrelation.fresh(Report('a', 4.0, np.zeros(3), (sighting(0.1, 0.2, measured=5.1),)))


def test_an_adopted_branch_equals_a_filter_that_saw_all():
    """In the linear regime and without process noise: first the one rig, then a branch adopted, or all at once."""
    settings = NetworkSettings(manoeuvre=0.0, heading_drift=0.0, clock_drift=0.0)
    rigs = [RigSettings('a', 0.02, 0.0, 0.0), RigSettings('b', 0.02, 0.01, 0.0)]
    truth = np.array([5.0, 60.0, 20.0, 3.0, 0.0, 0.0])
    places = np.array([-20.0, 0.0, 1.5]), np.array([20.0, 0.0, 1.5])

    def seen(rig):
        d = truth[:3] - places[rig]
        return Observation(rig, places[rig], 0.0, sighting(math.atan2(d[1], d[0]), math.atan2(d[2], math.hypot(d[0], d[1]))),
                           np.eye(2) * 1e-4)

    prior = np.diag([4.0] * 3 + [1.0] * 3)
    base = JointFilter(rigs, settings)
    base.predict(0.0)
    whole, branch = base.branch(), base.branch()
    for each in (whole, branch):
        each.add(truth, prior)
        each.update([(0, seen(0)), (0, seen(1))])
    base.adopt(branch)
    # What the branch learnt of headings is not taken over; given headings and clocks, the target is the same.
    n = 4
    for P in (base.covariance, whole.covariance):
        gain = np.linalg.solve(P[:n, :n], P[:n, n:])
        conditional = P[n:, n:] - P[n:, :n] @ gain
        assert np.allclose(gain, np.linalg.solve(whole.covariance[:n, :n], whole.covariance[:n, n:]), atol=1e-6)
        assert np.allclose(conditional, whole.covariance[n:, n:] - whole.covariance[n:, :n]
                           @ np.linalg.solve(whole.covariance[:n, :n], whole.covariance[:n, n:]), atol=1e-9)
    assert np.allclose(base.covariance[:n, :n], np.diag([0.02**2, 1e-12, 0.02**2, 1e-4]))


def test_considered_headings_stay():
    """Without learning, an update leaves the rigs' states and widens nothing."""
    rigs = [RigSettings('a'), RigSettings('b')]
    base = JointFilter(rigs, NetworkSettings())
    base.predict(0.0)
    base.add(np.array([0.0, 50.0, 10.0, 0.0, 0.0, 0.0]), np.diag([9.0] * 6))
    before = base.rig_state(0)
    base.update([(0, Observation(0, np.zeros(3), 0.0, sighting(1.6, 0.2), np.eye(2) * 1e-4))], learn=False)
    after = base.rig_state(0)
    assert np.array_equal(before[0], after[0]) and np.allclose(before[1], after[1])
    assert np.all(np.linalg.eigvalsh(base.covariance) > 0.0)
