"""What a rig tells other rigs: which values, how often, how many bytes."""

from __future__ import annotations

import math

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from test_fusion_stage import START, doa, make_stage

from av_common.stamps import to_seconds, to_stamp
from av_common.track import Source
from av_fusion.rig_reporter import RigReporter
from av_interfaces.msg import Track, TrackArray


def targets(time, count=1):
    tracks = [Track(id=number, existence=0.9, drone_probability=0.8, class_id='drone', azimuth=0.1, azimuth_world=0.5,
                    elevation_world=0.25, covariance_world=np.array([4e-4, 1e-5, 1e-5, 9e-4], np.float32),
                    source=int(Source.SOUND | Source.SIGHT), resolved=True, last_heard=to_stamp(time - 0.5),
                    last_seen=to_stamp(time - 0.25)) for number in range(1, count + 1)]
    return TrackArray(header=Header(stamp=to_stamp(time), frame_id='base_link'), tracks=tracks)


def test_a_report_holds_the_direction_in_the_world_and_the_place():
    """With the newest measurement's time, whichever sensor gave it."""
    report = RigReporter(4.0).report(targets(START), (1.0, 2.0, 3.0))
    (one,) = report.directions
    assert (one.id, one.azimuth, one.elevation, one.class_id) == (1, 0.5, 0.25, 'drone')
    assert np.allclose(one.covariance, [4e-4, 1e-5, 9e-4]) and one.seen and one.resolved
    assert to_seconds(one.measured) == START - 0.25 and to_seconds(report.header.stamp) == START
    assert list(report.position) == [1.0, 2.0, 3.0]
    assert np.all(np.isnan(RigReporter(4.0).report(targets(START), None).position))


def test_reports_are_as_rare_as_asked():
    """Of targets 20 times a second every fifth is told; a clock that is set back starts anew."""
    reporter = RigReporter(4.0)
    told = [k for k in range(40) if reporter.report(targets(START + 0.05 * k), None)]
    assert told == [0, 5, 10, 15, 20, 25, 30, 35]
    assert reporter.report(targets(START - 100.0), None)


def test_ten_targets_are_below_five_kilobytes_a_second():
    """With 250 bytes a message for Ethernet, IP, UDP and RTPS, encrypted, at four a second."""
    size = len(serialize_message(RigReporter(4.0).report(targets(START, 10), None)))
    assert 4 * (size + 250) < 5000


def test_the_position_is_that_of_the_odometry():
    """As the stage has it, which knows nothing of a place before the first pose."""
    stage = make_stage()
    assert stage.tracker.motion.position is None
    odometry = Odometry()
    odometry.header.stamp = to_stamp(START)
    odometry.pose.pose.orientation.w = 1.0
    odometry.pose.pose.position.x = 7.0
    stage.on_odometry(odometry, START)
    report = RigReporter(4.0).report(stage.on_doa(doa(START, 0.3), START + 0.1).targets, stage.tracker.motion.position)
    assert list(report.position) == [7.0, 0.0, 0.0]
    assert math.isclose(to_seconds(report.header.stamp), START, abs_tol=0.2)
