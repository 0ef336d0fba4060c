"""Two hypotheses without an axis are mirror images at the plane of a planar array, not the cone of a linear one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.angles import wrap
from av_fusion.measurement.measurements import DoaMeasurement, Hypothesis
from av_fusion.tracker import MultiTargetTracker

SIGMA = math.radians(2.0)


def follow(images, azimuth_at, seconds=8.0):
    """Track a target by `images(azimuth)`, ten times a second, on a rig that stands still; tracks and true azimuths."""
    random, tracker, tracks, truths = np.random.default_rng(4), MultiTargetTracker(), [], []
    for step in range(round(10 * seconds)):
        time, truth = 100.0 + 0.1 * step, azimuth_at(0.1 * step)
        measured = truth + float(random.normal(0.0, SIGMA))
        tracker.add_doa(DoaMeasurement(time, images(measured), 0.95, window=0.1))
        tracks.append(tracker.estimate(time))
        truths.append(truth)
    return tracks[20:], truths[20:]


def test_a_horizontal_plane_gives_azimuth_without_ambiguity():
    """Both images have one azimuth, above and below: the track follows it, as surely as it is measured, front from back."""
    tracks, truths = follow(lambda azimuth: tuple(Hypothesis(float(wrap(azimuth)), SIGMA**2, elevation, 0.01)
                                                  for elevation in (0.6, -0.6)), lambda time: -2.8 + 0.2 * time)
    errors = np.array([wrap(track.azimuth - truth) for track, truth in zip(tracks, truths, strict=True)])
    assert np.sqrt(np.mean(errors**2)) < SIGMA
    assert all(track.resolved and track.requested_rotation == 0.0 for track in tracks)
    assert all(track.azimuth_variance < (2.0 * SIGMA)**2 for track in tracks)


@pytest.mark.parametrize('elevation_deg', [0.0, 45.0])
def test_a_vertical_plane_mirrors_azimuth_whatever_the_elevation(elevation_deg):
    """Microphones on a wall across the rig's path: front and back are open, and neither image is bent by elevation."""
    elevation = math.radians(elevation_deg)
    tracks, truths = follow(lambda azimuth: tuple(Hypothesis(float(wrap(a)), SIGMA**2, elevation, 0.01)
                                                  for a in (azimuth, math.pi - azimuth)),
                            lambda time: 0.5 + 0.02 * time)
    nearest = [min((truth, math.pi - truth), key=lambda a, track=track: abs(wrap(a - track.azimuth)))
               for track, truth in zip(tracks, truths, strict=True)]
    errors = np.array([wrap(track.azimuth - azimuth) for track, azimuth in zip(tracks, nearest, strict=True)])
    assert np.sqrt(np.mean(errors**2)) < SIGMA
    assert not any(track.resolved for track in tracks)
    assert tracks[-1].requested_rotation != 0.0
