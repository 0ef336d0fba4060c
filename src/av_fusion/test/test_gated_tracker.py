"""The published switch: which measurement its bearing is, and how long it is kept."""

from __future__ import annotations

import math

import pytest

from av_common.track import Source, State
from av_fusion.gated_tracker import GatedTracker
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose

LEFT = (0.0, 1.0, 0.0)


def image(time, azimuth=None, score=0.9):
    found = () if azimuth is None else (Detection(azimuth, 1e-4, score, 0.1, 1e-4),)
    return CameraMeasurement(time, found)


def window(time, azimuth):
    """Of a pair: both mirror images."""
    return DoaMeasurement.of_cone(time, Cone(LEFT, math.sin(azimuth), 1e-3), 0.9)


def test_a_tau_that_is_lowered_counts_from_the_next_image_on():
    """Of a detection that was too weak when it came no direction is known."""
    tracker = GatedTracker()
    tracker.add_doas([window(100.0, 0.4)])
    tracker.add_camera(image(100.0, 0.3, 0.3))
    tracker.tune(0.2, 0.95)
    assert math.isfinite(tracker.estimate(100.1).azimuth)
    tracker.add_camera(image(100.1, 0.3, 0.3))
    track = tracker.estimate(100.1)
    assert track.state == State.VISUAL_ACTIVE and track.azimuth == pytest.approx(0.3)


@pytest.mark.parametrize('seen_last', [True, False])
def test_a_prediction_is_of_the_newest_measurement(seen_last):
    """Heard 5 s before it was last seen, or the other way round."""
    tracker, heard, seen = GatedTracker(), 100.0 if seen_last else 105.0, 105.0 if seen_last else 100.0
    for time in (100.0, 105.0):
        if time == heard:
            tracker.add_doas([window(time, 0.9)])
        if time == seen:
            tracker.add_camera(image(time, 0.1))
    track = tracker.estimate(106.5)
    assert track.state == State.COASTING and track.source == Source.NOTHING and track.measured == 105.0
    assert track.azimuth == pytest.approx(0.1 if seen_last else 0.9, abs=0.02)


def test_directions_of_long_ago_are_not_compared_with_after_a_turn():
    """The rig turned, and the target flew on, in silence."""
    tracker = GatedTracker()
    tracker.add_pose(Pose.level(100.0, 0.0))
    tracker.add_doas([window(100.0, 0.35)])
    for step in range(1, 101):
        tracker.add_pose(Pose.level(100.0 + 0.1 * step, 0.01 * step))
    tracker.add_doas([window(110.0, 0.7)])
    track = tracker.estimate(110.0)
    assert track.state == State.ACOUSTIC_ACTIVE and not track.resolved


@pytest.mark.parametrize('before', [[], [Pose.level(99.98, 0.0)]])
def test_a_correction_of_the_attitude_moves_no_bearing_on_the_body(before):
    """The first pose, or a jump, says that the rig faces elsewhere; what was measured in the body is where it was."""
    tracker = GatedTracker()
    for pose in before:
        tracker.add_pose(pose)
    tracker.add_doas([window(100.0, 0.4)])
    tracker.add_camera(image(100.0, 0.3))
    seen = tracker.estimate(100.0)
    tracker.add_pose(Pose.level(100.02, 1.5))
    track = tracker.estimate(100.02)
    assert seen.azimuth == pytest.approx(0.3) == track.azimuth and track.azimuth_world == pytest.approx(1.8)
