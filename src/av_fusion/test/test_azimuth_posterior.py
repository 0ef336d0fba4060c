"""The posterior in sectors, held against samples of its components and against the bearing that follows from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_fusion.measurement.rig_motion import Pose
from av_fusion.posterior import EDGES, SECTORS, _wrapped_normal, azimuth_posterior
from av_fusion.tracker import MultiTargetTracker

CENTRES = 0.5 * (EDGES[1:] + EDGES[:-1])


@pytest.mark.parametrize('azimuth', [0.3, math.pi, -3.1])
@pytest.mark.parametrize('sigma', [0.01, 0.2, 1.5])
def test_a_component_is_a_wrapped_normal_distribution(azimuth, sigma):
    samples = wrap(np.random.default_rng(3).normal(azimuth, sigma, 200_000))
    expected = np.histogram(samples, EDGES)[0] / len(samples)
    assert _wrapped_normal(azimuth, sigma**2) == pytest.approx(expected, abs=5.0 * math.sqrt(expected.max() / len(samples)))


def heard(tracker, azimuth, seconds=2.0, yaw=0.0):
    """A target that is heard by a rig that stands still; returns the time after."""
    sensors = SimulatedSensors(6)
    for step in range(int(seconds * 20)):
        time = 100.0 + step / 20.0
        tracker.add_pose(Pose.level(time, yaw))
        tracker.add_doas([sensors.doa(time, wrap(azimuth - yaw))])
        tracker.estimate(time)
    return time


def test_both_mirror_images_of_a_target_share_its_probability():
    """The array's axis is to the left: 40 degrees is heard as 140 degrees, too. The rig's heading is 70 degrees."""
    tracker = MultiTargetTracker()
    time = heard(tracker, math.radians(110.0), yaw=math.radians(70.0))
    probability = azimuth_posterior(tracker.densities(), tracker.motion, time)
    shares = [probability[np.abs(wrap(CENTRES - math.radians(side))) < math.radians(20.0)].sum() for side in (40.0, 140.0)]
    track = tracker.estimate(time)
    assert probability.shape == (SECTORS,) and probability.sum() <= 1.0 + 1e-9 and sum(shares) > 0.9
    assert shares[0] / sum(shares) == pytest.approx(track.front_probability, abs=0.05)


def test_an_old_posterior_is_not_one():
    tracker = MultiTargetTracker()
    time = heard(tracker, 0.5)
    assert azimuth_posterior(tracker.densities(), tracker.motion, time + 60.0).sum() == 0.0
