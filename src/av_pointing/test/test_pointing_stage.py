"""The pointing stage: commands of bearings and of time."""

from __future__ import annotations

import math

import pytest
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.rig import GimbalMount
from av_common.stamps import to_seconds, to_stamp
from av_common.track import State, Track
from av_common.track_messages import bearing_message
from av_interfaces.msg import PointingCommand
from av_pointing.settings import pointing_settings
from av_pointing.stage import make_pointing_stage

START = 1000.0


def at(time):
    """An instant `time` s after the start of all clocks."""
    return Instant(time, time)


def make_stage(**values):
    return make_pointing_stage(node_parameters('av_pointing', 'pointing_node', overrides={'enabled': True, **values}))


def move(stage, message, time):
    """The command that follows from a bearing, with odometry of the same time."""
    pose = Odometry()
    pose.header.stamp, pose.pose.pose.orientation.w = to_stamp(time), 1.0
    stage.on_odometry(pose, at(time))
    return stage.on_bearing(message, at(time))


def bearing(time, azimuth, resolved=True, rotation=0.0):
    return bearing_message(Track(time, State.ACOUSTIC_ACTIVE, azimuth=azimuth, azimuth_world=azimuth, measured=time,
                                 resolved=resolved, requested_rotation=rotation), 'base_link')


def test_one_message_says_all_that_a_command_needs():
    stage = make_stage()
    command = move(stage, bearing(START, 0.5), START)
    assert command.mode == PointingCommand.MODE_TRACK and command.move_body
    assert to_seconds(command.header.stamp) == START and command.header.frame_id == 'base_link'
    command = move(stage, bearing(START + 0.1, 0.5, resolved=False, rotation=-0.8), START + 0.1)
    assert command.mode == PointingCommand.MODE_SEARCH
    command = move(stage, bearing(START + 0.2, 0.5, resolved=False), START + 0.2)
    assert command.mode == PointingCommand.MODE_HOLD


def test_time_alone_moves_nothing_once_the_bearing_is_stale():
    stage = make_stage()
    assert stage.on_time(at(START)).mode == PointingCommand.MODE_HOLD
    move(stage, bearing(START, 0.5), START)
    assert stage.on_time(at(START + 0.1)).mode == PointingCommand.MODE_TRACK
    command = stage.on_time(at(START + 1.0))
    assert command.mode == PointingCommand.MODE_HOLD and 'no fresh bearing' in command.reason


def test_a_stage_that_is_not_enabled_moves_nothing():
    stage = make_stage(enabled=False)
    command = move(stage, bearing(START, 0.5), START)
    assert not command.move_body and not command.move_gimbal and command.yaw_rate == pytest.approx(0.0)
    stage.controller.enabled = True
    assert move(stage, bearing(START + 0.1, 0.5), START + 0.1).move_body


@pytest.mark.parametrize('topic', ['target/bearing', 'odometry'])
def test_an_input_with_two_publishers_stops_the_body(topic):
    """Fresh bearings of either publisher keep coming; the body stops within 0.35 s, and follows again when one is left."""
    stage = make_stage()
    for k in range(20):
        command = move(stage, bearing(START + 0.05 * k, 0.5), START + 0.05 * k)
    assert command.yaw_rate > 0.1
    stage.contested = {topic: ['/fusion_node', '/other']}
    for k in range(50):
        time = START + 0.95 + 0.02 * (k + 1)
        command = move(stage, bearing(time, 0.5), time)
        assert time < START + 0.95 + 0.35 or command.yaw_rate == pytest.approx(0.0)
    stage.contested = {}
    command = move(stage, bearing(time + 0.05, 0.5), time + 0.05)
    assert command.reason == 'following the bearing'


@pytest.mark.parametrize('norm', [0.0, 0.98, 1.02, math.nan])
def test_a_pose_that_came_without_attitude_is_not_new_when_it_comes_again(norm):
    """Ahead of its stamp the first time: the body stands 0.35 s after the newest pose that it could use."""
    stage = make_stage()
    for k in range(20):
        assert move(stage, bearing(START + 0.05 * k, 0.5), START + 0.05 * k).move_body
    pose = Odometry()
    pose.header.stamp, pose.pose.pose.orientation.w = to_stamp(START + 1.1), norm
    stage.on_odometry(pose, at(START + 1.0))
    pose.pose.pose.orientation.w = 1.0
    for k in range(20):
        time = START + 1.0 + 0.02 * k
        if k == 11:
            stage.on_odometry(pose, at(time))
        command = stage.on_bearing(bearing(time, 0.5), at(time))
        assert time < START + 0.95 + 0.35 or command.yaw_rate == pytest.approx(0.0, abs=1e-9)


def test_a_pose_that_was_used_is_not_new_when_its_time_comes_again_after_a_step_of_the_clock():
    """Set back by 3 s; poses no longer come but for the old ones, again: the body stands, until new ones come."""
    stage, sent = make_stage(), []
    for k in range(100):
        time = START + 0.05 * k
        assert move(stage, bearing(time, 0.5), time).move_body
        sent.append(time)
    rates = []
    for k in range(100):
        now = Instant(START + 5.0 + 0.05 * k, START + 2.01 + 0.05 * k)
        pose = Odometry()
        pose.header.stamp, pose.pose.pose.orientation.w = to_stamp(sent[40 + k] if k < 60 else now.ros), 1.0
        stage.on_odometry(pose, now)
        rates.append(stage.on_bearing(bearing(now.ros, 0.5), now).yaw_rate)
    assert rates[8:60] == pytest.approx([0.0] * 52) and rates[-1] > 0.1


@pytest.mark.parametrize('limit', [math.nan, math.inf, 0.0, -1.0])
def test_a_limit_that_is_none_leaves_the_one_before_until_nobody_states_one(limit):
    stage = make_stage()
    stage.on_yaw_rate_limit(Float32(data=0.25))
    with pytest.raises(ValueError, match='limit of'):
        stage.on_yaw_rate_limit(Float32(data=limit))
    assert stage.controller.body.limits.rate == 0.25
    stage.on_limiters(0)
    assert stage.controller.body.limits.rate == stage.controller.settings.yaw.rate


@pytest.mark.parametrize('rate', [0.4, 0.75, 1.0])
def test_the_body_turns_while_simulated_time_is_slow(rate):
    """As of a simulator on a busy machine: bearings 0.1 s old, 20 a second of simulated time."""
    stage, rates = make_stage(), []
    for k in range(300):
        now = Instant(START + 0.01 * k, START + 0.01 * rate * k)
        pose = Odometry()
        pose.header.stamp, pose.pose.pose.orientation.w = to_stamp(now.ros), 1.0
        stage.on_odometry(pose, now)
        command = stage.on_time(now)
        if k % round(5.0 / rate) == 0:
            command = stage.on_bearing(bearing(now.ros - 0.1, 0.5), now)
        rates.append(command.yaw_rate)
    assert min(rates[100:]) > 0.1


@pytest.mark.parametrize(('values', 'named'), [
    ({'body_follows_at_deg': 150.0}, r'body_follows_at_deg is 150, .*expected less than 150'),
    ({'body_follows_at_deg': 90.0}, 'body_follows_at_deg is 90, .*expected less than 60')])
def test_a_body_that_would_never_follow_is_refused_by_name(values, named):
    gimbal = None if values['body_follows_at_deg'] == 150.0 else GimbalMount(pan_limits_deg=(-60.0, 120.0))
    with pytest.raises(ValueError, match=named):
        pointing_settings(node_parameters('av_pointing', 'pointing_node', overrides=values), gimbal)
    pointing_settings(node_parameters('av_pointing', 'pointing_node', overrides={'body_follows_at_deg': 60.0}))


@pytest.mark.parametrize('back', [0.2, 0.8])
def test_a_bearing_that_rests_on_an_older_measurement_than_the_one_before_is_as_old_as_that(back):
    """As where another track is followed: the age of what was followed before must not be lent to it; braked within limits."""
    stage, rates = make_stage(), []
    for k in range(20):
        rates.append(move(stage, bearing(START + 0.05 * k, 1.5), START + 0.05 * k).yaw_rate)
    assert rates[-1] > 0.1
    for k in range(20):
        time = START + 0.95 + 0.02 * (k + 1)
        message = bearing(time, 1.5)
        message.measured = to_stamp(START + 0.95 - back)
        rates.append(move(stage, message, time).yaw_rate)
        assert abs(rates[-1] - rates[-2]) <= stage.controller.settings.yaw.acceleration * 0.02 + 1e-6
        assert time < START + max(0.95 - back + 0.3, 0.97) + 0.15 or rates[-1] == 0.0


def test_a_yaw_that_never_answers_the_commands_is_told():
    """The body is commanded at 0.6 rad/s and more; odometry turns with it in one run, and stands still in the other."""
    for turns in (True, False):
        stage, yaw, command = make_stage(), 0.0, None
        for k in range(60):
            yaw += 0.05 * command.yaw_rate if command and turns else 0.0
            pose, time = Odometry(), START + 0.05 * k
            pose.header.stamp = to_stamp(time)
            pose.pose.pose.orientation.w, pose.pose.pose.orientation.z = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
            stage.on_odometry(pose, at(time))
            command = stage.on_bearing(bearing(time, 1.5), at(time))
        assert command.yaw_rate > 0.2
        assert ('frozen' in stage.controller.body.problem) == (not turns)


def test_other_limits_of_rate_hold_from_the_next_commands_on_and_never_above_the_vehicles():
    """Slower than the vehicle's own limit, then faster than it: the smaller of both holds, and words say so."""
    stage, time = make_stage(), START
    stage.on_yaw_rate_limit(Float32(data=math.radians(30.0)))
    for own, most in ((45.0, 30.0), (10.0, 10.0), (90.0, 30.0)):
        stage.controller.set_yaw_rate(math.radians(own))
        rates = []
        for _ in range(40):
            time += 0.05
            rates.append(abs(math.degrees(move(stage, bearing(time, 2.0), time).yaw_rate)))
        assert max(rates[2:]) == pytest.approx(most, abs=0.1)
    assert stage.controller.may_move == 'the gimbal (up to 120 deg/s) and the body of the rig (up to 30 deg/s)'


@pytest.mark.parametrize(('gimbal', 'body', 'words'), [
    (True, False, 'the gimbal (up to 120 deg/s)'), (False, False, 'nothing')])
@pytest.mark.parametrize('enabled', [True, False])
def test_what_may_move_is_what_is_configured_whatever_was_commanded(gimbal, body, words, enabled):
    stage = make_stage(move_gimbal=gimbal, move_body=body, enabled=enabled)
    stage.on_time(at(START))
    assert stage.controller.may_move == words


def test_the_body_searches_to_the_side_that_is_asked_for_and_not_without_odometry():
    stage = make_stage(move_gimbal=False)
    for k in range(20):
        command = move(stage, bearing(START + 0.05 * k, 2.0, resolved=False, rotation=-0.8), START + 0.05 * k)
    assert command.mode == PointingCommand.MODE_SEARCH and command.yaw_rate < -0.1
    command = stage.on_bearing(bearing(START + 1.4, 2.0, resolved=False, rotation=-0.8), at(START + 1.4))
    assert command.mode == PointingCommand.MODE_HOLD and command.yaw_rate == 0.0 and 'odometry' in command.reason
