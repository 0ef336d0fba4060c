"""Bearings against analytic cases and their variances against repeated draws."""

import numpy as np
import pytest

from av_common.camera import PinholeCamera
from av_vision.bearing import BOX_FRACTION, CALIBRATION_SIGMA, PIXEL_SIGMA, bearings_of_boxes, pixel_variance

CAMERA = PinholeCamera.from_fov(640, 480, np.radians(70.0))


def test_left_and_up_in_the_image_are_positive():
    centre = np.array([319.5, 239.5])
    right, up = centre + np.array([CAMERA.fx * np.tan(0.3), 0]), centre - np.array([0, CAMERA.fy * np.tan(0.2)])
    bearings = bearings_of_boxes(CAMERA, [centre, right, up], np.ones((3, 2)), np.ones(3))
    assert bearings.azimuth == pytest.approx([0.0, -0.3, 0.0], abs=1e-9)
    assert bearings.elevation == pytest.approx([0.0, 0.0, 0.2], abs=1e-9)


def test_variance_of_a_pixel_in_the_middle_is_analytic():
    bearings = bearings_of_boxes(CAMERA, [[319.5, 239.5]], [[10, 10]], [1.0])
    expected = (np.hypot(PIXEL_SIGMA, 10 * BOX_FRACTION) / CAMERA.fx) ** 2 + CALIBRATION_SIGMA**2
    assert bearings.azimuth_variance == pytest.approx([expected], rel=1e-4)
    assert bearings.elevation_variance == pytest.approx([expected], rel=1e-4)


def test_variance_matches_the_scatter_off_axis_with_distortion():
    camera = PinholeCamera(640, 480, 450.0, 450.0, 320.0, 240.0, (-0.2, 0.05, 0.001, -0.001, 0.0))
    centre, size = np.array([560.0, 90.0]), np.array([30.0, 20.0])
    rng = np.random.default_rng(0)
    sigma = np.sqrt(pixel_variance(size, 0.5))
    centres = centre + rng.normal(size=(20000, 2)) * sigma
    drawn = bearings_of_boxes(camera, centres, np.tile(size, (20000, 1)), np.full(20000, 0.5))
    stated = bearings_of_boxes(camera, [centre], [size], [0.5])
    assert drawn.azimuth.var() == pytest.approx(stated.azimuth_variance[0] - CALIBRATION_SIGMA**2, rel=0.05)
    assert drawn.elevation.var() == pytest.approx(stated.elevation_variance[0] - CALIBRATION_SIGMA**2, rel=0.05)


def test_larger_and_less_sure_boxes_are_less_certain():
    bearings = bearings_of_boxes(CAMERA, np.full((3, 2), 300.0), [[10, 10], [100, 100], [10, 10]], [0.9, 0.9, 0.3])
    assert bearings.azimuth_variance[1] > bearings.azimuth_variance[0] < bearings.azimuth_variance[2]


def test_no_boxes():
    assert bearings_of_boxes(CAMERA, np.empty((0, 2)), np.empty((0, 2)), []).azimuth.shape == (0,)
