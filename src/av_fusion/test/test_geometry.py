"""From messages in sensor frames to measurements in the body frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from transforms3d.euler import euler2mat

from av_common.angles import angles_to_direction, wrap
from av_fusion.measurement.geometry import doa_in_body
from av_fusion.measurement.measurements import usable_doa
from av_interfaces.msg import Doa, DoaArray


def vector(values):
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def message(directions, axis=(0.0, 0.0, 0.0), variance=1e-3, group=0):
    """Unit vectors (n, 3) in the array's frame as hypotheses of one group."""
    hypotheses = []
    for direction in np.atleast_2d(directions):
        cosine = float(np.dot(direction, axis)) if np.any(axis) else math.nan
        hypotheses.append(Doa(direction=vector(direction), azimuth_variance=0.01, elevation_variance=0.02, cosine=cosine,
                              cosine_variance=variance if np.any(axis) else math.nan, confidence=0.8, ambiguity_group=group))
    return DoaArray(window=0.5, axis=vector(axis), hypotheses=hypotheses)


@pytest.mark.parametrize('azimuth', [0.2, 1.4, 3.0, -0.7])
@pytest.mark.parametrize('yaw', [0.0, 0.8, -2.5])
def test_a_linear_array_measures_a_cone_about_its_axis_in_the_body(azimuth, yaw):
    """The axis is rotated, the cosine stays as it was measured, and the images are where the hypotheses were."""
    images = angles_to_direction([azimuth, math.pi - azimuth])
    (found,) = doa_in_body(message(images, (0.0, 1.0, 0.0)), euler2mat(0.0, 0.0, yaw))
    assert found.cone.axis == pytest.approx((-math.sin(yaw), math.cos(yaw), 0.0))
    assert found.cone.cosine == pytest.approx(math.sin(azimuth)) and found.cone.variance == pytest.approx(1e-3)
    expected = sorted(float(wrap(a + yaw)) for a in (azimuth, math.pi - azimuth))
    assert sorted(h.azimuth for h in found.hypotheses) == pytest.approx(expected)
    assert all(h.across_variance == pytest.approx(0.01) for h in found.hypotheses)


def test_a_tilted_axis_counts_by_its_horizontal_part():
    """An array tilted by 30 degrees gives the azimuth of a level source."""
    rotation, azimuth = euler2mat(math.radians(30.0), 0.0, 0.0), 0.6
    source = rotation.T @ angles_to_direction(azimuth)
    cosine = source[1]
    images = [source, (-source[0], cosine, source[2])]
    (found,) = doa_in_body(message(images, (0.0, 1.0, 0.0)), rotation)
    assert min(abs(wrap(h.azimuth - azimuth)) for h in found.hypotheses) < 1e-9


def test_without_an_axis_two_hypotheses_are_directions():
    """Those of a planar array are mirror images at its plane, with an elevation each."""
    images = angles_to_direction([0.4, 0.4], [0.5, -0.5])
    (found,) = doa_in_body(message(images), np.eye(3))
    assert found.cone is None
    assert [h.elevation for h in found.hypotheses] == pytest.approx([0.5, -0.5])
    assert [h.azimuth for h in found.hypotheses] == pytest.approx([0.4, 0.4])
    assert found.hypotheses[0].elevation_variance == pytest.approx(0.02)


def test_a_single_hypothesis_is_a_direction_even_with_an_axis():
    """Only together do two images stand for a cone."""
    (found,) = doa_in_body(message(angles_to_direction([0.4]), (0.0, 1.0, 0.0)), np.eye(3))
    assert found.cone is None and found.hypotheses[0].azimuth == pytest.approx(0.4)


def test_groups_are_measurements_of_their_own_most_confident_first():
    both = message(angles_to_direction([0.4, math.pi - 0.4]), (0.0, 1.0, 0.0))
    both.hypotheses += message(angles_to_direction([1.0, math.pi - 1.0]), (0.0, 1.0, 0.0), group=1).hypotheses
    both.hypotheses[2].confidence = both.hypotheses[3].confidence = 0.9
    first, second = doa_in_body(both, np.eye(3))
    assert first.cone.cosine == pytest.approx(math.sin(1.0)) and first.confidence == 0.9
    assert second.cone.cosine == pytest.approx(math.sin(0.4))


@pytest.mark.parametrize(('cosine', 'variance'), [(1.5, 0.01), (0.5, math.nan), (0.5, 0.0), (math.inf, 0.01), (0.5, -1.0)])
def test_cones_that_cannot_be_are_not_used(cosine, variance):
    wrong = message(angles_to_direction([0.4, math.pi - 0.4]), (0.0, 1.0, 0.0))
    for hypothesis in wrong.hypotheses:
        hypothesis.cosine, hypothesis.cosine_variance = cosine, variance
    (found,) = doa_in_body(wrong, np.eye(3))
    assert found.cone is None or usable_doa(found) is None


@pytest.mark.parametrize('length', [1.007, 1e200])
def test_an_axis_that_is_no_unit_vector_is_named(length):
    """Also one that a cone could not have later on."""
    images = angles_to_direction([0.4, math.pi - 0.4])
    doas = message(images, (0.0, 1.0, 0.0))
    doas.axis.y = length
    with pytest.raises(ValueError, match=f'axis of length {length:g}'.replace('+', '[+]')):
        doa_in_body(doas, np.eye(3))


def test_directions_without_measure_do_not_stop_the_fusion():
    """A message may hold thousands; the strongest are used."""
    sent = message(angles_to_direction(np.linspace(-3.0, 3.0, 5000)), (0.0, 0.0, 0.0))
    for group, one in enumerate(sent.hypotheses):
        one.ambiguity_group = group
    found = doa_in_body(sent, np.eye(3))
    assert len(found) <= 100 and found[0].hypotheses[0].azimuth == pytest.approx(-3.0, abs=0.01)
