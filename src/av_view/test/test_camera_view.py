"""Directions in the picture, held against rays of the same camera and against geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_view.camera_view import CameraView

IDEAL = PinholeCamera.from_fov(640, 480, math.radians(70.0))
DISTORTED = PinholeCamera(640, 480, IDEAL.fx, IDEAL.fy, IDEAL.cx, IDEAL.cy, (-0.2, 0.05, 0.0, 0.0))


def view(camera=IDEAL, roll=0.0, pitch=0.0, yaw=0.0):
    return CameraView(camera, rotation_from_rpy(roll, pitch, yaw) @ FLU_TO_OPTICAL.T)


@pytest.mark.parametrize('camera', [IDEAL, DISTORTED])
@pytest.mark.parametrize('turn', [{}, {'yaw': 3.0}, {'roll': 0.3, 'pitch': -0.4, 'yaw': -1.0}])
def test_the_ray_through_a_point_has_the_direction(camera, turn):
    seen = view(camera, **turn)
    for pixel in ([320.0, 240.0], [100.0, 50.0], [600.0, 400.0]):
        ray = seen.rotation @ camera.rays([pixel])[0]
        azimuth, elevation = math.atan2(ray[1], ray[0]), math.asin(ray[2])
        assert seen.point(azimuth, elevation) == pytest.approx([(pixel[0] + 0.5) / 640, (pixel[1] + 0.5) / 480], abs=1e-3)
        assert seen.azimuth_of(*pixel) == pytest.approx(azimuth, abs=1e-9)


def test_a_level_camera_shows_a_meridian_as_a_vertical_line():
    line = np.array(view().meridian(math.radians(20.0)))
    expected = 0.5 - 0.5 * math.tan(math.radians(20.0)) / math.tan(math.radians(35.0))  # to the left of the centre
    assert line[:, 0] == pytest.approx(expected, abs=1e-3)
    assert line[:, 1].min() < 0.0 and line[:, 1].max() > 1.0  # from below the picture to above it


def test_the_line_of_a_portrait_camera_goes_from_below_the_picture_to_above_it():
    line = np.array(view(PinholeCamera.from_fov(480, 640, math.radians(50.0))).meridian(math.radians(20.0)))
    assert line[:, 1].min() < 0.0 and line[:, 1].max() > 1.0


def test_the_band_has_the_width_of_two_sigma_and_is_clipped():
    band = np.array(view().band(0.0, math.radians(5.0)))
    half = 0.5 * math.tan(math.radians(5.0)) / math.tan(math.radians(35.0))
    assert (band[:, 0].min(), band[:, 0].max()) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-3)
    whole = np.array(view().band(0.0, math.radians(170.0)))
    assert np.isfinite(whole).all() and whole[:, 0].min() < 0.0 < 1.0 < whole[:, 0].max()


def test_what_is_behind_the_camera_is_not_in_the_picture():
    seen = view(yaw=math.radians(170.0))
    assert seen.meridian(0.0) == [] and seen.band(0.0, 0.1) == [] and seen.point(0.0, 0.0) is None
    assert seen.point(math.radians(-170.0), 0.0) is not None  # across +-180 degrees
    assert seen.band(math.nan, 0.1) == [] and seen.band(0.0, math.nan) == [] and seen.meridian(math.nan) == []
