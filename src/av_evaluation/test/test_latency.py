"""The offset between the clocks of microphones and camera is found from a target that moves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.angles import wrap
from av_evaluation.cli.estimate_latency import estimate_offset


def curves(offset, seed=0, turned=0.0, scale=1.0, amplitude=0.5):
    """A target swinging before the camera: 10 directions a second with stamps `offset` s late, 12 detections a second."""
    random = np.random.default_rng(seed)
    path = lambda t: amplitude * np.sin(0.9 * t) + 0.3 * amplitude * np.sin(2.3 * t + 1.0)  # noqa: E731
    measured_at, seen_at = np.arange(0.0, 40.0, 0.1), np.arange(0.0, 40.0, 1.0 / 12.0)
    cosine = scale * np.cos(path(measured_at) - 0.5 * math.pi - turned) + random.normal(0.0, 0.01, len(measured_at))
    half = np.arccos(cosine)
    seen = path(seen_at) + random.normal(0.0, 0.005, len(seen_at))
    return (measured_at + offset, wrap(0.5 * math.pi + half), wrap(0.5 * math.pi - half)), (seen_at, seen)


@pytest.mark.parametrize('offset', [-0.35, -0.04, 0.0, 0.012, 0.2])
def test_the_offset_is_found(offset):
    """To a few ms, also with an axis that is turned by 5 degrees and a baseline 5 % too long."""
    found = estimate_offset(*curves(offset, turned=math.radians(5.0), scale=1.05))
    assert found.seconds == pytest.approx(offset, abs=0.01) and found.sigma < 0.02


def test_the_offset_of_an_array_without_mirror_images_is_found():
    (times, _, second), seen = curves(0.2)    # the second one is where the target is
    assert estimate_offset((times, second, np.full(len(times), np.nan)), seen).seconds == pytest.approx(0.2, abs=0.01)


def test_sigma_is_honest():
    """Errors over seeds are of the size that sigma says."""
    found = [estimate_offset(*curves(0.1, seed)) for seed in range(30)]
    pulls = np.array([(one.seconds - 0.1) / one.sigma for one in found])
    assert 0.1 < np.std(pulls) < 1.5 and abs(np.mean(pulls)) < 1.0


def test_too_little_is_refused():
    """A target at rest, too few sightings, and one that is never seen twice tell nothing."""
    measured, seen = curves(0.0)
    with pytest.raises(ValueError, match='hardly moves'):
        estimate_offset(*curves(0.0, amplitude=0.001))
    with pytest.raises(ValueError, match='sightings'):
        estimate_offset(measured, (seen[0][:5], seen[1][:5]))
    with pytest.raises(ValueError, match='in view'):
        estimate_offset(measured, (seen[0][::20].repeat(3)[:60], seen[1][::20].repeat(3)[:60]))
