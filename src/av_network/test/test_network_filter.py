"""The filters of targets, headings and clocks, and what they are made of, against independent calculations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import multivariate_normal

from av_network.apparent_direction import apparent_directions
from av_network.hypothesis_filter import HypothesisFilter
from av_network.lone_track import separate
from av_network.motion_model import usual_modes
from av_network.observation import Observation
from av_network.report import Sighting
from av_network.settings import Mode, NetworkSettings, RigSettings

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


PLACES = np.array([-20.0, 0.0, 1.5]), np.array([20.0, 0.0, 1.5])
TRUTH = np.array([5.0, 60.0, 20.0, 3.0, 0.0, 0.0])


def seen(rig, truth=TRUTH):
    d = truth[:3] - PLACES[rig]
    angles = np.array([math.atan2(d[1], d[0]), math.atan2(d[2], math.hypot(d[0], d[1]))])
    return Observation(rig, PLACES[rig], sighting(*angles, measured=0.0))


def two_rigs(**settings):
    rigs = [RigSettings('a', 0.02, 0.0, 0.0), RigSettings('b', 0.02, 0.01, 0.0)]
    states = HypothesisFilter(rigs, NetworkSettings(**settings))
    states.predict(0.0)
    return states


def update(states, rows, one, learn):
    innovations = states.innovations([one])
    states.update(one.rig, np.array(rows), innovations.pick(np.array(rows), np.zeros(len(rows), int)),
                  np.full(len(rows), learn))


def test_many_targets_at_once_are_what_each_is_alone():
    """An update of some of the targets, against the textbook's equations for one, and nothing of the others."""
    states = two_rigs()
    means = TRUTH + np.array([[1.0, -2.0, 1.0, 0, 0, 0], [0, 3.0, 0, 1.0, 0, 0], [20.0, 0, 0, 0, 0, 0]])
    states.add(means, np.array([np.diag([9.0] * 3 + [4.0] * 3)] * 3))
    mean, P = states.mean.copy(), states.covariance.copy()
    found = states.innovations([seen(1)])
    update(states, [0, 2], seen(1), True)
    for row in (0, 2):
        densities = []
        for mode in (0, 1):
            H = np.zeros((2, 13))
            H[:, [2, 3, *range(4, 10)]] = found.jacobians[row, 0, mode]
            S = H @ P[row, mode] @ H.T + np.eye(2) * 1e-4
            gain = P[row, mode] @ H.T @ np.linalg.inv(S)
            assert np.allclose(states.mean[row, mode], mean[row, mode] + gain @ found.residuals[row, 0, mode])
            assert np.allclose(states.covariance[row, mode], (np.eye(13) - gain @ H) @ P[row, mode])
            densities.append(multivariate_normal.pdf(found.residuals[row, 0, mode], cov=S))
        weighed = usual_modes(NetworkSettings()) * densities
        assert np.allclose(states.modes[row], weighed / weighed.sum(), atol=2e-3)
        assert found.log_density[row, 0] == pytest.approx(math.log(weighed.sum()))
    assert np.array_equal(states.mean[1], mean[1]) and np.array_equal(states.covariance[1], P[1])


def test_new_headings_move_targets_as_far_as_they_depend_on_them():
    """Two rigs see a target; a heading that turns out to be off turns its position, and what was known given headings stays."""
    states = two_rigs(modes=(Mode(0.0, 1.0, 1.0),))
    states.add(TRUTH[None], np.array([np.diag([100.0] * 3 + [1.0] * 3)]))
    for rig in (0, 1):
        update(states, [0], seen(rig), True)
    before, conditional = states.targets()[0][0], states.conditional_covariances(np.array([0]))[0]
    turn = np.array([0.01, 0.0, 0.01, 0.0])
    states.set_rigs(turn, np.diag([1e-6, 1e-12, 1e-6, 1e-12]))
    # Both directions turn by 0.01 rad about their rigs: where they meet, by the intersection of two lines in the plane.
    azimuths = [seen(rig).angles[0] + 0.01 for rig in (0, 1)]
    lines = np.array([[math.sin(a), -math.cos(a)] for a in azimuths])
    place = np.linalg.solve(lines, [line @ origin[:2] for line, origin in zip(lines, PLACES, strict=True)])
    assert np.linalg.norm(before[:2] - TRUTH[:2]) < 0.1
    assert np.allclose(states.targets()[0][0, :2] - TRUTH[:2], place - TRUTH[:2], atol=0.15)
    assert np.allclose(states.conditional_covariances(np.array([0]))[0], conditional, atol=1e-6)


def test_considered_clocks_stay():
    """Without learning, an update leaves clocks and widens nothing."""
    states = two_rigs()
    states.add(TRUTH[None] + 1.0, np.diag([9.0] * 6)[None])
    before, P, clocks = states.mean[0, :, 1:4:2].copy(), states.covariance[0].copy(), np.ix_([0, 1], [1, 3], [1, 3])
    update(states, [0], seen(1), False)
    assert np.array_equal(states.mean[0, :, 1:4:2], before) and np.allclose(states.covariance[0][clocks], P[clocks])
    assert np.all(np.linalg.eigvalsh(states.covariance[0]) > 0.0)
    assert np.all(states.covariance[0, :, 4, 4] < P[:, 4, 4])


def test_density_of_a_lone_track_is_that_of_its_motion():
    """Against the joint Gaussian density of three directions to one target whose acceleration is short, and less in height."""
    distance, times, sigma = 50.0, np.array([0.0, 0.3, 0.7]), 0.01
    settings = NetworkSettings((Mode(math.sqrt(2e4), 1e-4, 1.0),), speed_sigma=8.0, climb_share=0.5, velocity_memory=1e9)
    azimuths = np.array([0.1, 0.16, 0.19])
    observations = [Observation(0, np.zeros(3), sighting(a, 0.0, sigma, measured=time))
                    for time, a in zip(times, azimuths, strict=True)]
    track, total = None, 0.0
    for one in observations:
        ((track, density),) = separate([track], [one], np.array([[distance, 0.0, 0.0]]), 0.2, settings)
        total += density
    # Given the first angle, later ones vary by its error, by the rate, and by twice integrated white noise.
    s, t = np.minimum.outer(times[1:], times[1:]), np.maximum.outer(times[1:], times[1:])
    motion = (8.0 / distance)**2 * np.outer(times[1:], times[1:]) + 4.0 / distance**2 * (s**2 * t / 2.0 - s**3 / 6.0)
    expected = math.log(0.2) + sum(
        multivariate_normal.logpdf(angles, [angle] * 2, sigma**2 * (1.0 + np.eye(2)) + share * motion)
        for angle, angles, share in ((azimuths[0], azimuths[1:], 1.0), (0.0, np.zeros(2), 0.25)))
    assert total == pytest.approx(expected, rel=1e-3)
