"""Visibility in synthetic fog, against Beer-Lambert's law."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_vision.visibility import estimate, ground_distances

CAMERA = PinholeCamera.from_fov(320, 240, np.radians(70.0))


def landscape(extinction, seed=0):
    """Textured flat ground under a sky, seen through fog from 1.5 m, and the distances."""
    rotation = rotation_from_rpy(0.0, 0.1, 0.0) @ FLU_TO_OPTICAL.T
    distance = ground_distances(CAMERA, 1.5, rotation)
    rng = np.random.default_rng(seed)
    clear = np.where(np.isfinite(distance), rng.normal(95.0, 35.0, distance.shape), 210.0)
    left = np.where(np.isfinite(distance), np.exp(-extinction * distance), 0.0)
    return np.clip(205.0 + left * (clear - 205.0) + rng.normal(0, 2, distance.shape), 0, 255).astype(np.uint8), distance


@pytest.mark.parametrize('extinction', [0.02, 0.05, 0.1, 0.2, 0.4])
def test_extinction_within_a_fifth(extinction):
    seen = estimate(*landscape(extinction), target_distance=10.0)
    assert seen.extinction == pytest.approx(extinction, rel=0.2)
    assert seen.share == pytest.approx(np.exp(-10.0 * extinction), abs=0.05)
    assert seen.range == pytest.approx(np.log(20.0) / extinction, rel=0.25)


def test_ground_distance_is_the_triangle():
    distance = ground_distances(CAMERA, 2.0, FLU_TO_OPTICAL.T)
    assert np.isinf(distance[:119]).all()
    row = 200
    depression = np.arctan((row - CAMERA.cy) / CAMERA.fy)
    assert distance[row, 160] == pytest.approx(2.0 / np.sin(depression), rel=0.01)


def test_without_scale_more_fog_is_less_visibility():
    shares = [estimate(landscape(extinction)[0]).share for extinction in (0.01, 0.05, 0.15, 0.5)]
    assert all(a > b for a, b in pairwise(shares))
    assert np.isnan(estimate(landscape(0.05)[0]).range)


def test_nothing_at_a_known_distance_is_unknown():
    image, _ = landscape(0.1)
    assert np.isnan(estimate(image, np.zeros(image.shape, np.float32)).share)
    assert np.isnan(estimate(image, np.full(image.shape, 5.0, np.float32)).extinction)


def bars(image):
    image[:30] = image[-30:] = 0


def round_picture(image):
    rows, columns = np.indices(image.shape)
    image[np.hypot(rows - 119.5, columns - 159.5) > 150.0] = 3


@pytest.mark.parametrize('frame', [bars, round_picture])
@pytest.mark.parametrize('extinction', [0.01, 0.1, 0.4])
def test_what_frames_a_picture_says_nothing_about_the_air(frame, extinction):
    """The bars of a video, the corners beside a fisheye's picture."""
    image, distance = landscape(extinction)
    plain = [estimate(image).share, estimate(image, distance).share]
    frame(image)
    assert [estimate(image).share, estimate(image, distance).share] == pytest.approx(plain, abs=0.15)


@pytest.mark.parametrize(('mean', 'noise', 'blurred'), [(3.0, 3.0, 0.0), (10.0, 6.0, 1.5), (25.0, 8.0, 1.0), (0.0, 1.0, 0.0)])
def test_the_noise_of_a_dark_image_is_not_clear_air(mean, noise, blurred):
    """At night, or below a cap; demosaicing makes the noise of neighbours alike."""
    values = np.random.default_rng(2).normal(0.0, 1.0, (480, 640))
    values = gaussian_filter(values, blurred) if blurred else values
    image = np.clip(mean + noise * values / values.std(), 0, 255).astype(np.uint8)
    assert estimate(image).share < 0.15
