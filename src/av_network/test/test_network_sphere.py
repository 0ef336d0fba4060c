"""Directions on the sphere, against vectors and rotations, and rigs' filters that are undone close to the zenith."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_common.angles import angles_to_direction, direction_to_angles
from av_network import sphere
from av_network.motion_model import nearly_constant_velocity
from av_network.report import Report, Sighting
from av_network.tracklets import Tracklets


def units(angles):
    return angles_to_direction(angles[..., 0], angles[..., 1])


@pytest.mark.parametrize('seed', range(5))
def test_offsets_are_arcs_of_great_circles(seed):
    """Their lengths are the angles between the vectors, and a rotation about the axis of the arc leads there."""
    random = np.random.default_rng(seed)
    one, other = (np.stack([random.uniform(-math.pi, math.pi, 50), random.uniform(-1.57, 1.57, 50)], 1) for _ in (0, 1))
    arcs = sphere.offsets(other, one)
    assert np.allclose(np.linalg.norm(arcs, axis=1), np.arccos(np.sum(units(one) * units(other), axis=1)))
    vectors = sphere.vectors(arcs, one)
    turned = Rotation.from_rotvec(np.cross(units(one), vectors)).apply(units(one))
    assert np.allclose(turned, units(other)) and np.allclose(units(sphere.moved(one, vectors)), units(other))
    beside = sphere.vectors(random.normal(size=(50, 2)), one)
    turn = Rotation.from_rotvec(np.cross(units(one), vectors))
    assert np.allclose(sphere.carried(beside, one, other), turn.apply(beside))


def test_small_offsets_are_those_of_azimuth_and_elevation():
    """To the second order: the difference of the azimuths times cos(elevation), and that of the elevations."""
    one, other = np.array([3.1415, 0.6]), np.array([-3.1415, 0.6003])
    assert np.allclose(sphere.offsets(other, one), [(2.0 * math.pi - 6.283) * math.cos(0.6), 0.0003], atol=1e-7)


@pytest.mark.parametrize('seed', range(3))
def test_tracklets_are_consistent_over_the_zenith(seed):
    """A target that passes 2 deg beside the zenith: the azimuth turns by 170 deg within a second, the direction by 20."""
    random, sigma, step, density = np.random.default_rng(seed), 0.01, 0.1, 0.001
    F, Q = nearly_constant_velocity(step, density)
    P, squared, tracklets = np.diag([sigma**2, 0.3**2]), [], Tracklets(density, 0.3)
    state = np.zeros((2, 2))  # arcs along and across the path, and their rates
    path = Rotation.from_euler('x', math.radians(2.0))

    def direction(along, across):
        return path.apply([math.sin(along) * math.cos(across), math.sin(across), math.cos(along) * math.cos(across)])

    for k in range(80):
        truth = 0.4 * (k * step - 4.0)
        measured = np.array([truth, 0.0]) + sigma * random.normal(size=2)
        if k == 0:
            state[:, 0] = measured
        else:
            state, P = state @ F.T, F @ P @ F.T + Q
            gain = P[:, 0] / (P[0, 0] + sigma**2)
            state = state + np.outer(measured - state[:, 0], gain)
            P = P - np.outer(gain, P[0])
        angles = np.array(direction_to_angles(direction(*state[:, 0])))
        one = Sighting(1, *map(float, angles), np.eye(2) * P[0, 0], k * step)
        for each in tracklets.fresh(Report('a', k * step, np.zeros(3), (one,))):
            error = sphere.offsets(each.angles, np.array(direction_to_angles(direction(truth, 0.0))))
            squared.append(float(error @ np.linalg.solve(each.covariance, error)))
    assert len(squared) == 80 and not any(map(math.isnan, squared))
    assert 1.3 < np.mean(squared[5:]) < 2.7
