"""Where the gimbal points: from what it reports, and from the model of its commands where it does not."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from transforms3d.euler import euler2quat
from transforms3d.quaternions import mat2quat, quat2mat

from av_common.angles import angles_to_direction
from av_common.frames import attitude_of
from av_common.gimbal_geometry import gimbal_to_body
from av_common.rig import GimbalMount, load_rig
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_stamp
from av_interfaces.msg import GimbalState, PointingCommand
from av_pointing.gimbal_stage import GimbalStage

RIG = load_rig(Path(__file__).resolve().parents[3] / 'config' / 'rig_gimbal.yaml')
TILTED = euler2quat(*np.radians([20.0, -15.0, 70.0]), 'sxyz')
T = 1000.0


def odometry(time, attitude=TILTED):
    message = Odometry(header=Header(stamp=to_stamp(time), frame_id='odom'), child_frame_id='base_link')
    message.pose.pose.orientation = Quaternion(**dict(zip('wxyz', map(float, attitude), strict=True)))
    return message


def command(time, pan, tilt=0.0, frame='base_stabilized'):
    return PointingCommand(header=Header(stamp=to_stamp(time), frame_id=frame), move_gimbal=True, pan=pan, tilt=tilt)


def feedback(time, pan=0.0, attitude=TILTED):
    turned = mat2quat(gimbal_to_body(RIG.gimbal, pan, 0.0, attitude))
    return gimbal_message(RIG.gimbal.frame, time, turned, 1e-4, measured=True)


def joints(time, **positions):
    return JointState(header=Header(stamp=to_stamp(time)), name=list(positions), position=list(positions.values()))


def sight(state):
    return quat2mat(attitude_of(state.orientation))[:, 0]


def test_the_model_stays_level_on_a_tilting_rig_at_the_instant_of_its_pose():
    stage = GimbalStage(RIG)
    stage.on_odometry(odometry(T), T)
    stage.on_command(command(T, 0.6), T)
    state = stage.on_odometry(odometry(T + 1.0), T + 1.02)
    assert state.source == GimbalState.SOURCE_MODEL
    assert state.header.stamp == to_stamp(T + 1.0)
    assert np.allclose(quat2mat(TILTED) @ sight(state), angles_to_direction(math.radians(70.0) + 0.6, 0.0), atol=1e-6)
    transform = stage.on_state(state, T + 1.03)
    assert (transform.header.frame_id, transform.child_frame_id) == ('base_link', 'gimbal_link')


def test_without_odometry_the_rig_counts_as_level_and_the_variance_says_so():
    stage = GimbalStage(RIG)
    stage.on_command(command(T, 0.6), T)
    state = stage.on_time(T + 1.0)
    assert np.allclose(sight(state), angles_to_direction(0.6, 0.0), atol=1e-6)
    stage.on_odometry(odometry(T + 2.0), T + 2.0)
    known = stage.on_odometry(odometry(T + 2.1), T + 2.1)
    assert known.variance < 0.2 * state.variance


def test_feedback_goes_before_the_model_and_its_end_is_told():
    stage = GimbalStage(RIG)
    stage.on_odometry(odometry(T), T)
    assert stage.on_state(feedback(T, 0.4), T + 0.01) is not None
    assert stage.on_odometry(odometry(T + 0.05), T + 0.05) is None
    assert not stage.problem(T + 0.1)
    state = stage.on_odometry(odometry(T + 0.6), T + 0.6)
    assert state.source == GimbalState.SOURCE_MODEL
    assert np.allclose(quat2mat(TILTED) @ sight(state), angles_to_direction(math.radians(70.0) + 0.4, 0.0), atol=1e-6)
    assert 'no orientation any more' in stage.problem(T + 0.6)


def test_joints_turn_about_the_axes_of_the_body():
    stage = GimbalStage(RIG, ('yaw', '-pitch', ''))
    state = stage.on_joints(joints(T, yaw=0.5, wheel=7.0, pitch=0.2), T)
    assert state.source == GimbalState.SOURCE_FEEDBACK
    assert np.allclose(sight(state), angles_to_direction(0.5, -0.2))
    assert stage.on_joints(joints(T, wheel=7.0), T) is None
    assert GimbalStage(RIG).on_joints(joints(T, yaw=0.5, pitch=0.2), T) is None


@pytest.mark.parametrize('message', [joints(T, yaw=math.nan, pitch=0.0), JointState(name=['yaw', 'pitch'], position=[1.0])])
def test_impossible_joints_are_refused(message):
    with pytest.raises(ValueError, match='joints'):
        GimbalStage(RIG, ('yaw', 'pitch', '')).on_joints(message, T)


def hostile_states():
    bent, late, early, jump, foreign = (feedback(T + 0.1) for _ in range(5))
    bent.orientation.w = math.nan
    late.header.stamp, early.header.stamp = to_stamp(T + 9.0), to_stamp(T - 5.0)
    jump = feedback(T + 0.02, 2.0)
    foreign.header.frame_id = 'map'
    return [bent, late, early, jump, foreign]


@pytest.mark.parametrize('message', hostile_states())
def test_hostile_orientations_are_refused_and_never_used(message):
    stage = GimbalStage(RIG)
    stage.on_state(feedback(T), T)
    with pytest.raises(ValueError, match='.'):
        stage.on_state(message, T + 0.1)
    assert stage.history.newest.time == T


@pytest.mark.parametrize('message', [
    command(T, math.nan), command(T, 1.0, math.inf), command(T + 5.0, 1.0), command(T - 5.0, 1.0),
    command(T, 1.0, frame='map')])
def test_hostile_commands_move_no_model(message):
    stage = GimbalStage(RIG)
    with pytest.raises(ValueError, match='.'):
        stage.on_command(message, T)
    assert np.allclose(sight(stage.on_time(T + 1.0)), (1.0, 0.0, 0.0))


@pytest.mark.parametrize(('time', 'attitude'), [(T, (math.nan, 0.0, 0.0, 0.0)), (T, (0.0, 0.0, 0.0, 0.0)), (T + 5.0, TILTED)])
def test_hostile_odometry_tilts_no_model(time, attitude):
    stage = GimbalStage(RIG)
    with pytest.raises(ValueError, match='.'):
        stage.on_odometry(odometry(time, attitude), T)
    assert np.allclose(sight(stage.on_time(T)), (1.0, 0.0, 0.0))


def test_a_command_in_the_body_frame_is_turned_level():
    stage = GimbalStage(RIG)
    stage.on_odometry(odometry(T), T)
    stage.on_command(command(T, 0.3, 0.1, frame='base_link'), T)
    state = stage.on_odometry(odometry(T + 0.2), T + 0.2)
    assert np.allclose(sight(state), angles_to_direction(0.3, 0.1), atol=1e-6)


def test_an_old_clock_that_is_set_back_does_not_silence_the_model():
    stage = GimbalStage(RIG)
    stage.on_time(T)
    assert stage.on_time(10.0) is not None
    assert stage.on_odometry(odometry(10.2), 10.2) is not None


def test_the_model_has_lag_rate_and_limits_and_knows_less_while_it_moves():
    """Before the first command it knows nothing; the first tells where the gimbal is."""
    rig = replace(RIG, gimbal=GimbalMount(stabilized=False, max_rate_deg=90.0, lag=0.1, pan_limits_deg=(-100.0, 100.0)))
    stage, states = GimbalStage(rig), []
    unknown = stage.on_time(T).variance
    stage.on_command(command(T + 0.01, 0.0, frame='base_link'), T + 0.01)
    rest = stage.on_time(T + 0.02).variance
    stage.on_command(command(T + 0.03, math.radians(120.0), frame='base_link'), T + 0.03)
    for step in range(200):
        states.append(stage.on_time(T + 0.04 + 0.02 * step))
    pans = np.degrees([math.atan2(*sight(state)[1::-1]) for state in states])
    assert (np.diff(pans) / 0.02).max() == pytest.approx(90.0) and pans[-1] == pytest.approx(100.0)
    assert unknown > 20.0 * rest and states[20].variance > 20.0 * rest
    assert states[-1].variance == pytest.approx(rest, rel=0.01)
