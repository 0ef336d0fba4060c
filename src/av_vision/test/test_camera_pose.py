"""Where the image goes when the camera turns: checked against points projected by both poses."""

import numpy as np
import pytest

from av_common.angles import angles_to_direction
from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_vision.camera_pose import CameraPose, pixel_of, turned

CAMERA = PinholeCamera(640, 480, 457.0, 457.0, 319.5, 239.5, (-0.08, 0.02, 0.0005, -0.0003, 0.0))
MOUNT = rotation_from_rpy(0.0, -0.2, 0.1) @ FLU_TO_OPTICAL.T


def pose(roll, pitch, yaw):
    return CameraPose(CAMERA, MOUNT, rotation_from_rpy(roll, pitch, yaw) @ MOUNT)


def test_a_rotation_moves_pixels_as_it_moves_distant_points():
    before, now = pose(0.0, 0.0, 0.0), pose(0.05, -0.1, 0.2)
    pixels = np.random.default_rng(0).uniform([200, 150], [440, 330], (50, 2))
    points = 1e3 * CAMERA.rays(pixels) @ before.to_world.T
    assert turned(pixels, before, now) == pytest.approx(CAMERA.project(points @ now.to_world), abs=1e-3)


def test_what_turns_behind_the_camera_is_nowhere():
    assert np.isnan(turned(np.array([[320.0, 240.0]]), pose(0, 0, 0), pose(0, 0, np.pi))).all()


def test_without_attitude_only_the_mount_turns():
    gimbal = [CameraPose(CAMERA, rotation_from_rpy(0.0, 0.0, yaw) @ MOUNT) for yaw in (0.0, 0.1)]
    world = [pose(0.0, 0.0, 0.0), pose(0.0, 0.0, 0.1)]
    pixels = np.array([[300.0, 200.0]])
    assert turned(pixels, *gimbal) == pytest.approx(turned(pixels, *world), abs=1e-6)


def test_directions_are_in_the_image_where_the_camera_sees_them():
    rotation = rotation_from_rpy(0.0, 0.0, 0.5) @ FLU_TO_OPTICAL.T  # level, 0.5 rad to the left
    assert pixel_of(angles_to_direction(0.5, 0.0), rotation, CAMERA) == pytest.approx([CAMERA.cx, CAMERA.cy], abs=1e-6)
    left_and_up = pixel_of(angles_to_direction(0.6, 0.1), rotation, CAMERA)
    assert left_and_up[0] < CAMERA.cx
    assert left_and_up[1] < CAMERA.cy
    assert pixel_of(angles_to_direction(0.5 + np.pi, 0.0), rotation, CAMERA) is None
    assert pixel_of(angles_to_direction(1.8, 0.0), rotation, CAMERA) is None
