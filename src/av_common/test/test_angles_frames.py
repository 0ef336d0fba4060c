"""Angles and frames against cases anyone can draw."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from transforms3d.euler import euler2quat
from transforms3d.quaternions import quat2mat

from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, direction_to_angles, wrap
from av_common.frames import (
    FLU_TO_OPTICAL,
    FRD_TO_FLU,
    NED_TO_ENU,
    attitude_ned_to_enu,
    frd_to_flu,
    ned_to_enu,
    rotation_from_rpy,
    yaw_of,
)
from av_common.quaternions import between, inverse, product, quaternion_of, rotation, vector_of


def test_wrap_keeps_pi_and_turns_minus_pi():
    """The circle is (-pi, pi]; arrays keep their shape."""
    assert wrap(math.pi) == pytest.approx(math.pi) and wrap(-math.pi) == pytest.approx(math.pi)
    assert np.allclose(wrap([[0.0, 7.0], [-7.0, 100.0]]), [[0.0, 7.0 - 2 * math.pi], [2 * math.pi - 7.0, 100.0 - 32 * math.pi]])


def test_directions_and_angles_are_inverse():
    """x is azimuth 0, y is azimuth +90 degrees (left), z is elevation +90 degrees."""
    assert np.allclose(angles_to_direction([0.0, math.pi / 2, 0.0], [0.0, 0.0, math.pi / 2]), np.eye(3), atol=1e-12)
    random = np.random.default_rng(1)
    azimuth, elevation = random.uniform(-3, 3, 50), random.uniform(-1.5, 1.5, 50)
    assert np.allclose(direction_to_angles(angles_to_direction(azimuth, elevation)), (azimuth, elevation))


def test_rotations_are_those_of_scipy_whatever_the_sign_of_a_quaternion():
    """Products, matrices, vectors, and places on the shortest way between two."""
    for pair in Rotation.random(20, random_state=1).as_quat().reshape(10, 2, 4):
        (first, second), (p, q) = map(Rotation.from_quat, pair), np.roll(pair, 1, axis=1).tolist()
        assert np.allclose(rotation(product(p, inverse(q))), (first * second.inv()).as_matrix())
        assert np.allclose(vector_of(p), first.as_rotvec())
        assert np.allclose(rotation(quaternion_of(vector_of(p))), first.as_matrix())
        way = Slerp([0.0, 1.0], Rotation.concatenate([first, second]))
        for other in (q, [-part for part in q]):
            assert np.allclose(rotation(between(p, other, 0.3)), way(0.3).as_matrix())


def test_axes_of_the_frames():
    """North is y in ENU, down is -z; right is -y in FLU; the optical axis is the camera's forward."""
    assert np.array_equal(ned_to_enu([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0])
    assert np.array_equal(frd_to_flu([1.0, 2.0, 3.0]), [1.0, -2.0, -3.0])
    assert np.array_equal(FLU_TO_OPTICAL @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    assert np.array_equal(FLU_TO_OPTICAL @ [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0])


@pytest.mark.parametrize(('heading_deg', 'yaw_deg'), [(0, 90), (90, 0), (180, -90), (-90, 180), (45, 45)])
def test_heading_and_yaw(heading_deg, yaw_deg):
    """North-facing is yaw 90 degrees."""
    quaternion = euler2quat(math.radians(heading_deg), 0.0, 0.0, 'rzyx')
    assert math.degrees(yaw_of(attitude_ned_to_enu(quaternion))) == pytest.approx(yaw_deg, abs=1e-9)


def test_an_attitude_is_turned_as_its_rotation_matrix():
    """Any attitude, of any norm, there and back."""
    for attitude in np.random.default_rng(3).normal(size=(50, 4)):
        turned = attitude_ned_to_enu(attitude)
        assert np.allclose(quat2mat(turned), NED_TO_ENU @ quat2mat(attitude) @ FRD_TO_FLU.T)
        assert np.allclose(quat2mat(attitude_ned_to_enu(turned)), quat2mat(attitude))
        assert np.linalg.norm(turned) == pytest.approx(1.0) and turned[0] >= 0.0


def test_pitch_up_points_the_nose_up():
    """A positive pitch in NED/FRD is nose up; fixed-axis pitch in FLU is nose down, so that -8 degrees looks up."""
    nose = np.array([[1.0, 0.0, 0.0]])
    assert (nose @ rotation_from_rpy(0.0, math.radians(-8.0), 0.0).T)[0, 2] > 0.1


def test_speed_of_sound():
    """343.2 m/s at 20 degrees Celsius, as tables say; kelvin by mistake is refused."""
    assert speed_of_sound(20.0) == pytest.approx(343.2, abs=0.2)
    with pytest.raises(ValueError, match='temperature_c is 293'):
        speed_of_sound(293.0)
