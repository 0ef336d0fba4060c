"""Directions on the sphere, against vectors and rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_common.angles import angles_to_direction
from av_network import sphere


def units(angles):
    return angles_to_direction(angles[..., 0], angles[..., 1])


@pytest.mark.parametrize('seed', range(5))
def test_offsets_are_arcs_of_great_circles(seed):
    """Their lengths are the angles between the vectors, and a rotation about the axis of the arc leads there."""
    random = np.random.default_rng(seed)
    one, other = (np.stack([random.uniform(-math.pi, math.pi, 50), random.uniform(-1.57, 1.57, 50)], 1) for _ in (0, 1))
    arcs = sphere.offsets(other, one)
    assert np.allclose(np.linalg.norm(arcs, axis=1), np.arccos(np.sum(units(one) * units(other), axis=1)))
    vectors = np.einsum('ni,nij->nj', arcs, sphere.axes(one))
    turn = Rotation.from_rotvec(np.cross(units(one), vectors))
    assert np.allclose(turn.apply(units(one)), units(other)) and np.allclose(units(sphere.moved(one, arcs)), units(other))
    beside = np.einsum('ni,nij->nj', random.normal(size=(50, 2)), sphere.axes(one))
    assert np.allclose(sphere.carried(beside, one, other), turn.apply(beside))


def test_small_offsets_are_those_of_azimuth_and_elevation():
    """To the second order: the difference of the azimuths times cos(elevation), and that of the elevations."""
    one, other = np.array([3.1415, 0.6]), np.array([-3.1415, 0.6003])
    assert np.allclose(sphere.offsets(other, one), [(2.0 * math.pi - 6.283) * math.cos(0.6), 0.0003], atol=1e-7)
