"""The ring, held against scipy's normal distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm

from av_view.posterior_ring import BINS, posterior_ring

CENTRES = -math.pi + (np.arange(BINS) + 0.5) * math.tau / BINS


def test_a_narrow_bearing_is_a_normal_distribution():
    ring = np.array(posterior_ring(0.4, 0.2**2, None, 1.0))
    expected = norm.pdf(CENTRES, 0.4, 0.2)
    assert ring == pytest.approx(expected / expected.max(), abs=2e-3)


def test_the_mirror_image_has_the_rest_of_the_probability():
    ring = np.array(posterior_ring(0.5, 0.1**2, math.pi - 0.5, 0.8))
    front, back = ring[np.abs(CENTRES - 0.5) < 0.5].sum(), ring[np.abs(CENTRES - math.pi + 0.5) < 0.5].sum()
    assert back / (front + back) == pytest.approx(0.2, abs=0.01)


def test_the_ring_is_closed_at_180_degrees():
    ring = posterior_ring(math.pi, 0.3**2, None, 1.0)
    assert ring[0] == ring[-1] > 0.9 > ring[BINS // 2]


@pytest.mark.parametrize(('azimuth', 'variance'), [(math.nan, 0.1), (0.0, math.inf), (0.0, math.nan), (0.0, -1.0)])
def test_what_says_nothing_has_no_ring(azimuth, variance):
    assert posterior_ring(azimuth, variance, None, 1.0) == []


def test_a_bearing_without_error_is_still_seen():
    assert max(posterior_ring(1.0, 0.0, None, 1.0)) == 1.0
