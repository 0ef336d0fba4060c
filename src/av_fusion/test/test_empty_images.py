"""What an image that shows nothing tells of a direction, against the same density on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.sight import Extent, truncated


@pytest.mark.parametrize('mean_deg', [-60.0, -20.0, 0.0, 15.0, 25.0, 40.0])
@pytest.mark.parametrize('seen', [0.1, 0.5, 0.9])
def test_moments_are_those_of_what_is_left(mean_deg, seen):
    covariance = np.diag([0.01, math.radians(12.0) ** 2, 0.01, 0.01, 0.001])
    past = GaussianComponent(1.0, 0.3, math.radians(mean_deg), np.ones(1), np.zeros((1, 5)), covariance[None]).at(0.0)
    half, angle = math.radians(27.0), math.radians(mean_deg)
    shift, change = truncated(Extent(angle, (0.0, 1.0), half), past, seen)
    grid = np.linspace(angle - 1.5, angle + 1.5, 60001)
    density = np.exp(-0.5 * (grid - angle) ** 2 / covariance[1, 1]) * (1.0 - seen * (np.abs(grid) < half))
    density /= density.sum()
    mean = float(density @ grid)
    variance = float(density @ (grid - mean) ** 2)
    assert angle + shift[0] == pytest.approx(mean, abs=1e-4)
    assert covariance[1, 1] + change[0] == pytest.approx(variance, rel=1e-3)
