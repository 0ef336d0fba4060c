"""What an image that shows nothing tells of a direction, against the same density on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_fusion.measurement.measurements import CameraMeasurement
from av_fusion.measurement.vectors import IDENTITY
from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.sight import Image, compare
from av_fusion.tracks.track import _update_by_image


@pytest.mark.parametrize('mean_deg', [-60.0, -20.0, 0.0, 15.0, 25.0, 40.0])
@pytest.mark.parametrize('seen', [0.1, 0.5, 0.9])
def test_moments_are_those_of_what_is_left(mean_deg, seen):
    covariance = np.diag([0.01, math.radians(12.0) ** 2, 0.01, 0.01, 0.001])
    past = GaussianComponent(1.0, 0.3, math.radians(mean_deg), np.ones(1), np.zeros((1, 5)), covariance[None]).at()
    half, angle = math.radians(27.0), math.radians(mean_deg)
    left, shift, change = past.beyond(angle, (0.0, 1.0), ((1.0, half), (-1.0, -half)), seen)
    grid = np.linspace(angle - 1.5, angle + 1.5, 60001)
    density = np.exp(-0.5 * (grid - angle) ** 2 / covariance[1, 1]) * (1.0 - seen * (np.abs(grid) < half))
    assert left[0] == pytest.approx(density.sum() / np.exp(-0.5 * (grid - angle) ** 2 / covariance[1, 1]).sum(), rel=1e-3)
    density /= density.sum()
    mean = float(density @ grid)
    variance = float(density @ (grid - mean) ** 2)
    assert angle + shift[0] == pytest.approx(mean, abs=1e-4)
    assert covariance[1, 1] + change[0] == pytest.approx(variance, rel=1e-3)


@pytest.mark.parametrize('place_deg', [(0.0, 0.0), (30.0, 20.0), (33.0, 25.0), (-40.0, 30.0)])
def test_empty_images_leave_a_covariance_whose_angles_are_correlated(place_deg):
    """As of a cone far from its axis: both angles are beyond the edges together, or neither is."""
    sigmas = np.radians([10.0, 12.0])
    covariance = np.diag([sigmas[0] ** 2, sigmas[1] ** 2, 0.01, 0.01, 0.001])
    covariance[0, 1] = covariance[1, 0] = 0.99 * sigmas[0] * sigmas[1]
    azimuth, elevation = np.radians(place_deg)
    component = GaussianComponent(1.0, azimuth, elevation, np.ones(1), np.zeros((1, 5)), covariance[None])
    measurement = CameraMeasurement(0.0, (), math.radians(35.0), math.radians(27.0), 1.0)
    image = Image(0.0, measurement, [], list(IDENTITY), 1.0, True, 0.3)
    for _ in range(30):
        compared = compare(component, component.at(), image, 0.9)
        _update_by_image(image, compared, np.zeros(0), 0.9)
        assert np.linalg.eigvalsh(component.covariances[0]).min() > 0.0
