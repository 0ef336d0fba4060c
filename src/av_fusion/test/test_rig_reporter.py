"""What a rig tells other rigs: what its measurements added, how often, how many bytes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from test_fusion_stage import START, doa, make_stage

from av_common.stamps import to_seconds, to_stamp
from av_fusion.measurement.measurements import CameraMeasurement, Detection
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.rig_reporter import RigReporter
from av_fusion.tracks.evidence import Increment
from av_fusion.tracks.filter import MultiBernoulliFilter
from av_fusion.tracks.settings import FilterSettings
from av_interfaces.msg import RigReport, Track, TrackArray

SIGMA, PERIOD = 0.01, 0.1  # rad and s; errors of images are alike for 0.3 s


class Measured:
    """A track whose increments are given."""

    def __init__(self, number, found):
        self.id, self._found = number, found

    def increment(self):
        found, self._found = self._found, None
        return found


def targets(time, count=1):
    return TrackArray(header=Header(stamp=to_stamp(time), frame_id='base_link'), tracks=[
        Track(id=number, existence=0.9, drone_probability=0.8, class_id='drone', resolved=True)
        for number in range(1, count + 1)])


def added(time, count=1):
    return [Measured(number, Increment(time - 0.25, True, 0.5, 0.25, 900.0, 7.0, 400.0)) for number in range(1, count + 1)]


def test_a_report_holds_what_was_added_and_the_place_of_that_time():
    """The second one nothing of a target that was not measured again; a rig that moves was behind when it measured."""
    motion = RigMotion()
    for k in range(3):
        motion.add(Pose(START - 1.0 + 0.5 * k, velocity=(4.0, 0.0, 0.0), position=(2.0 * k, 2.0, 3.0)))
    reporter, tracks = RigReporter(), added(START)
    report = reporter.report(targets(START), tracks, motion)
    (one,) = report.directions
    assert (one.id, one.azimuth, one.elevation, one.class_id) == (1, 0.5, 0.25, 'drone')
    assert list(one.information) == [900.0, 7.0, 400.0] and one.seen and one.resolved and report.version == RigReport.VERSION
    assert to_seconds(one.measured) == START - 0.25 == to_seconds(report.header.stamp)
    assert list(report.position) == pytest.approx([3.0, 2.0, 3.0])
    assert not reporter.report(targets(START + 0.5), tracks, motion).directions
    assert np.all(np.isnan(RigReporter().report(targets(START), added(START), RigMotion()).position))


def test_reports_are_as_rare_as_asked():
    """Of targets 20 times a second every fifth is told; a clock that is set back starts anew."""
    reporter = RigReporter()
    told = [k for k in range(40) if reporter.report(targets(START + 0.05 * k), [], RigMotion())]
    assert told == [0, 5, 10, 15, 20, 25, 30, 35]
    assert reporter.report(targets(START - 100.0), [], RigMotion())


def test_ten_targets_are_below_five_kilobytes_a_second():
    """With 250 bytes a message for Ethernet, IP, UDP and RTPS, encrypted, at four a second."""
    size = len(serialize_message(RigReporter().report(targets(START, 10), added(START, 10), RigMotion())))
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
    output = stage.on_doa(doa(START, 0.3), START + 0.1)
    report = RigReporter().report(output.targets, stage.tracker.densities(), stage.tracker.motion)
    assert list(report.position) == [7.0, 0.0, 0.0]
    assert not report.directions
    assert START - 1.0 < to_seconds(report.header.stamp) <= START - 0.45, 'sound of then may still come'


def increments(seed, rate, every=3, count=900):
    """Increments of a target that turns about the rig at a rate (rad/s), seen every PERIOD, with the true azimuths then."""
    random, motion = np.random.default_rng(seed), RigMotion()
    motion.add(Pose(0.0))
    states, found = MultiBernoulliFilter(FilterSettings(), motion), []
    for k in range(1, count):
        time = PERIOD * k
        azimuth, elevation = rate * time + SIGMA * random.normal(), 0.3 + SIGMA * random.normal()
        seen = Detection(math.remainder(azimuth, math.tau), (SIGMA * math.cos(0.3))**2, 0.95, elevation, SIGMA**2)
        states.update_image(time, CameraMeasurement(time, (seen,), math.pi, 0.5 * math.pi, 1.0))
        if k % every == 0 and k > 30:
            (one,) = [track.increment() for track in states.confirmed]
            found.append((one, rate * one.time))
    return found[1:]


@pytest.mark.parametrize('rate', [0.0, 0.05, 0.3])
def test_increments_are_the_measurements_alone(rate):
    """Their errors have no correlation in time, and a third of the variance: three images say as much as one does."""
    found = increments(5, rate)
    across = np.array([math.remainder(one.azimuth - azimuth, math.tau) * math.cos(0.3) * math.sqrt(one.hh)
                       for one, azimuth in found])
    up = np.array([(one.elevation - 0.3) * math.sqrt(one.vv) for one, _ in found])
    for errors in (across, up):
        assert np.mean(errors**2) == pytest.approx(1.0 / 3.0, abs=0.08)
        assert abs(np.mean(errors)) < 0.1 and abs(np.mean(errors[1:] * errors[:-1])) < 0.07
    assert found[0][0].hh == pytest.approx(1.0 / (SIGMA * math.cos(0.3))**2, rel=0.1)


def test_what_is_heard_by_two_microphones_is_one_angle():
    """A cone says nothing along itself: its information has one direction only."""
    stage = make_stage()
    for k in range(6):
        output = stage.on_doa(doa(START + 0.25 * k, 0.3), START + 0.25 * k + 0.1)
    (one,) = RigReporter().report(output.targets, stage.tracker.densities(), stage.tracker.motion).directions
    hh, hv, vv = map(float, one.information)
    assert not one.seen and hh > 100.0 and hh * vv - hv**2 < 1e-3 * hh**2


def test_a_clock_that_begins_at_zero_gives_reports_at_once():
    """As that of a simulator: what was measured before it began has no stamp."""
    assert to_seconds(RigReporter().report(targets(0.1), [], RigMotion()).header.stamp) == 0.0
