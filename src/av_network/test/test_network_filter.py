"""The filter of targets and the densities of hypotheses, against independent calculations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import multivariate_normal

from av_network import motion_model
from av_network.apparent_direction import apparent_directions
from av_network.hypothesis_filter import HypothesisFilter
from av_network.lone_track import separate
from av_network.motion_model import Mode, usual_modes
from av_network.observation import Observation, RigState, Sighting

SOUND = 343.2
EXACT = RigState(0.0, 0.0, 0.0, 0.0, 0.0)


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
    assert np.allclose(found.angles[0], expected, atol=1e-9)
    level = np.array([math.cos(expected[1]), 1.0])
    step = 1e-5
    for axis in range(3):
        shift = np.eye(3)[axis] * step
        by_position = level * (angles(position + shift, velocity, 0.2) - angles(position - shift, velocity, 0.2)) / (2 * step)
        by_velocity = level * (angles(position, velocity + shift, 0.2) - angles(position, velocity - shift, 0.2)) / (2 * step)
        assert np.allclose(found.by_state[0, :, axis], by_position, atol=1e-7)
        assert np.allclose(found.by_state[0, :, 3 + axis], by_velocity, atol=1e-7)
    by_time = level * (angles(position, velocity, 0.2 + step) - angles(position, velocity, 0.2 - step)) / (2 * step)
    assert np.allclose(found.by_time[0], by_time, atol=1e-7)


PLACES = np.array([-20.0, 0.0, 1.5]), np.array([20.0, 0.0, 1.5])
TRUTH = np.array([5.0, 60.0, 20.0, 3.0, 0.0, 0.0])


def seen(rig, truth=TRUTH, known=EXACT):
    d = truth[:3] - PLACES[rig]
    angles = np.array([math.atan2(d[1], d[0]), math.atan2(d[2], math.hypot(d[0], d[1]))])
    return Observation(rig, PLACES[rig], sighting(*angles, measured=0.0), known)


def test_many_targets_at_once_are_what_each_is_alone():
    """An update of some of the targets, against the textbook's equations for one, and nothing of the others."""
    states = HypothesisFilter()
    states.predict(0.0)
    means = TRUTH + np.array([[1.0, -2.0, 1.0, 0, 0, 0], [0, 3.0, 0, 1.0, 0, 0], [20.0, 0, 0, 0, 0, 0]])
    states.add(means, np.array([np.diag([9.0] * 3 + [4.0] * 3)] * 3))
    mean, P, used = states.mean.copy(), states.covariance.copy(), np.array([0, 2])
    found = states.innovations([seen(1)])
    states.update(used, found.pick(used, np.zeros(2, int)))
    for row in used:
        densities = []
        for mode in (0, 1):
            H = np.concatenate([found.jacobians[row, 0, mode], np.zeros((2, 3))], 1)
            S = H @ P[row, mode] @ H.T + np.eye(2) * 1e-4
            gain = P[row, mode] @ H.T @ np.linalg.inv(S)
            assert np.allclose(states.mean[row, mode], mean[row, mode] + gain @ found.residuals[row, 0, mode])
            assert np.allclose(states.covariance[row, mode], (np.eye(9) - gain @ H) @ P[row, mode])
            densities.append(multivariate_normal.pdf(found.residuals[row, 0, mode], cov=S))
        weighed = usual_modes() * densities
        assert np.allclose(states.modes[row], weighed / weighed.sum(), atol=2e-3)
        assert found.log_density[row, 0] == pytest.approx(math.log(weighed.sum()))
    assert np.array_equal(states.mean[1], mean[1]) and np.array_equal(states.covariance[1], P[1])


def test_uncertain_headings_and_clocks_are_errors_of_directions():
    """A heading of 20 mrad, by the elevation, and a clock of 0.1 s, by the target's motion of 3 m/s."""
    states = HypothesisFilter()
    states.predict(0.0)
    states.add(TRUTH[None], np.diag([1e-6] * 6)[None])
    exact, uncertain = (states.innovations([seen(1, known=known)]) for known in (EXACT, RigState(0.1, 0.0, 0.02, 0.1, 0.5)))
    offset = TRUTH[:3] - PLACES[1]
    level, distance = math.hypot(offset[0], offset[1]), float(np.linalg.norm(offset))
    across, up = (axis @ TRUTH[3:] / distance for axis in (
        np.array([-offset[1], offset[0], 0.0]) / level,
        np.array([-offset[0] * offset[2], -offset[1] * offset[2], level**2]) / (level * distance)))
    expected = (np.diag([4e-4 * (level / distance)**2, 0.0]) + 0.25 / distance**2 * np.eye(2)
                + 0.01 * np.outer([across, up], [across, up]))
    assert np.allclose((uncertain.covariances - exact.covariances)[0, 0, 0], expected, atol=1e-9)
    assert uncertain.residuals[0, 0, 0, 0] == pytest.approx(0.1 * level / distance, rel=0.02)


def test_density_of_a_lone_track_is_that_of_its_motion(monkeypatch):
    """Against the joint Gaussian density of three directions to one target that flies steadily, and less in height."""
    distance, times, sigma = 50.0, np.array([0.0, 0.3, 0.7]), 0.01
    for name, value in (('MODES', (Mode(1e-6, 1.0, 1.0),)), ('CLIMB_SHARE', 0.5), ('VELOCITY_MEMORY_S', 1e9)):
        monkeypatch.setattr(motion_model, name, value)
    azimuths = np.array([0.1, 0.16, 0.19])
    observations = [Observation(0, np.zeros(3), sighting(a, 0.0, sigma, measured=time), EXACT)
                    for time, a in zip(times, azimuths, strict=True)]
    track, total = None, 0.0
    for one in observations:
        ((track, density),) = separate([track], [one], np.array([[distance, 0.0, 0.0]]), 0.2)
        total += density
    # Given the first angle, later ones vary by its error and by the rate.
    motion = (8.0 / distance)**2 * np.outer(times[1:], times[1:])
    expected = math.log(0.2) + sum(
        multivariate_normal.logpdf(angles, [angle] * 2, sigma**2 * (1.0 + np.eye(2)) + share * motion)
        for angle, angles, share in ((azimuths[0], azimuths[1:], 1.0), (0.0, np.zeros(2), 0.25)))
    assert total == pytest.approx(expected, rel=1e-3)


def test_a_lone_track_passes_overhead():
    """A drone at 8 m/s, 25 m above a rig and 1 m beside it: its azimuth and the axes there turn round within half a second."""
    track, densities = None, []
    for time in np.arange(-4.0, 4.1, 0.25).tolist():
        azimuth, elevation = math.atan2(1.0, 8.0 * time), math.atan2(25.0, math.hypot(8.0 * time, 1.0))
        one = Observation(0, np.zeros(3), sighting(azimuth, elevation, measured=time), EXACT)
        ((track, density),) = separate([track], [one], np.array([[8.0 * time, 1.0, 25.0]]), 0.4)
        densities.append(density)
    assert min(densities[2:]) > 5.0 > math.log(0.4), 'nothing contradicts its track'
