"""What PX4's gimbal reports becomes the rig's gimbal state, and commands are obeyed in their frame."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from test_px4_stage import Rig
from transforms3d.euler import euler2quat
from transforms3d.quaternions import qinverse, qmult, quat2mat

from av_common.angles import angles_to_direction
from av_common.frames import attitude_ned_to_enu, attitude_of
from av_common.rig import GimbalMount
from av_common.stamps import to_seconds
from av_interfaces.msg import GimbalState
from av_px4.gimbal import YAW_IN_EARTH_FRAME, YAW_IN_VEHICLE_FRAME, YAW_LOCK, GimbalFeedback

HEADING, PITCH, ROLL = np.radians([130.0, 15.0, -20.0])
VEHICLE = euler2quat(ROLL, PITCH, HEADING, 'sxyz')  # FRD to NED
NAMES = ('base_link', 'gimbal_link')


def report(flags, yaw_deg, pitch_deg, time=50.0, **changes):
    """MAVLink: roll and pitch from the horizon, yaw to the right of north or of the heading."""
    q = euler2quat(0.0, math.radians(pitch_deg), math.radians(yaw_deg), 'sxyz')
    usual = {'timestamp': round(1e6 * time), 'device_flags': flags, 'q': list(q), 'failure_flags': 0,
             'received_from_mavlink': True}
    return SimpleNamespace(**usual | changes)


def converted(make, attitude=VEHICLE):
    feedback, state = GimbalFeedback(NAMES[1]), None
    for step in range(60):
        state = feedback.convert(make(50.0 + 0.05 * step), 1000.0 + 0.05 * step, attitude)
    return state, feedback


@pytest.mark.parametrize(('flags', 'yaw'), [
    (12 + YAW_IN_VEHICLE_FRAME, -40.0), (12, -40.0), (YAW_IN_EARTH_FRAME, 90.0), (YAW_LOCK, 90.0),
    (YAW_LOCK + YAW_IN_VEHICLE_FRAME, -40.0)])
def test_the_gimbal_looks_where_it_reports_from_a_vehicle_that_tilts(flags, yaw):
    """At heading 130, 40 deg to the left is 90 deg from north: the east."""
    state, feedback = converted(lambda time: report(flags, yaw, 25.0, time))
    world = quat2mat(attitude_ned_to_enu(VEHICLE)) @ quat2mat(attitude_of(state.orientation))
    assert np.allclose(world[:, 0], angles_to_direction(0.0, math.radians(25.0)), atol=1e-6)
    assert world[2, 1] == pytest.approx(0.0, abs=1e-6)  # level
    assert np.degrees(feedback.reported) == pytest.approx([40.0, 25.0])
    assert (state.source, state.header.frame_id, state.child_frame_id) == (GimbalState.SOURCE_FEEDBACK, *NAMES)
    assert to_seconds(state.header.stamp) == pytest.approx(1000.0 + 0.05 * 59, abs=1e-3)


def test_a_setpoint_is_no_measurement():
    """What PX4 reports for a gimbal on PWM outputs is where a claim begins, no more."""
    state, feedback = converted(lambda time: report(YAW_IN_VEHICLE_FRAME, -40.0, 25.0, time, received_from_mavlink=False))
    assert state is None and np.degrees(feedback.reported) == pytest.approx([40.0, 25.0])


@pytest.mark.parametrize(('silence', 'begins'), [(0.0, -40.0), (2.0, -57.0)])
def test_a_claim_begins_where_the_gimbal_reports_to_be_and_where_it_was_commanded_to_if_it_is_silent(silence, begins):
    """An old report would have it jump back there."""
    rig = Rig()

    def point(seconds):
        for _ in range(round(10.0 * seconds)):
            rig.run(0.1, pan=1.0)
            rig.acknowledge()
    point(2.0)
    rig.take('gimbal_device_attitude_status', report(YAW_IN_VEHICLE_FRAME, -40.0, 0.0, rig.time))
    point(silence)
    rig.stage.gimbal.release()
    rig.run(0.02, pan=1.0)
    rig.acknowledge()
    taken = rig.time
    rig.run(0.06, pan=1.0)
    first = next(message for message in rig.of('vehicle_command', since=taken) if message.command == 1000)
    assert first.param2 == pytest.approx(begins, abs=1.0)


def test_without_the_vehicles_attitude_nothing_is_said():
    assert converted(lambda time: report(YAW_IN_VEHICLE_FRAME, 0.0, 0.0, time), None)[0] is None


@pytest.mark.parametrize('changes', [
    {'q': [math.nan, 0.0, 0.0, 0.0]}, {'q': [0.5, 0.0, 0.0, 0.0]}, {'q': [0.0] * 4}, {'failure_flags': 8},
    {'failure_flags': 256}, {'device_flags': YAW_IN_EARTH_FRAME + YAW_IN_VEHICLE_FRAME}])
def test_the_impossible_is_refused(changes):
    with pytest.raises(ValueError, match='.'):
        converted(lambda time: report(0, 0.0, 0.0, time, **changes))


def test_the_stage_publishes_it_and_not_without_a_fresh_attitude():
    rig = Rig()
    for _ in range(100):
        rig.run(0.02)
        rig.take('gimbal_device_attitude_status', report(YAW_IN_VEHICLE_FRAME, -40.0, 25.0, rig.time))
    assert len(rig.of('gimbal/state')) > 90
    rig.silent, began = {'vehicle_odometry'}, rig.time
    for _ in range(50):
        rig.run(0.02)
        rig.take('gimbal_device_attitude_status', report(YAW_IN_VEHICLE_FRAME, -40.0, 25.0, rig.time))
    assert not rig.of('gimbal/state', began + 0.3)


@pytest.mark.parametrize(('frame', 'locked', 'expected'), [
    ('base_stabilized', True, (10.0, 30.0)), ('base_link', True, None), ('base_link', False, (10.0, 30.0)),
    ('base_stabilized', False, None)])
def test_a_command_is_obeyed_in_its_frame(frame, locked, expected):
    """From a nose that is pitched down; what changes the frame agrees with the rotation between them."""
    rig = Rig(GimbalMount(stabilized=locked))
    nose_down = euler2quat(0.0, math.radians(-20.0), 0.0, 'sxyz')
    rig.run(0.1)
    rig.stage._attitude = list(nose_down)
    from av_interfaces.msg import PointingCommand
    command = PointingCommand(move_gimbal=True, pan=math.radians(10.0), tilt=math.radians(30.0))
    command.header.frame_id = frame
    rig.stage._command = command
    inputs = rig.stage._gimbal_inputs(rig.stage._guard_inputs())
    if expected is not None:
        assert np.degrees((inputs.pan, inputs.tilt)) == pytest.approx(expected)
        return
    level = quat2mat(attitude_ned_to_enu(nose_down))
    turn = quat2mat(qmult(qinverse(attitude_ned_to_enu(euler2quat(0.0, 0.0, 0.0))), attitude_ned_to_enu(nose_down)))
    assert level.shape == (3, 3)
    given = angles_to_direction(math.radians(10.0), math.radians(30.0))
    sent = angles_to_direction(inputs.pan, inputs.tilt)
    assert np.allclose(sent, turn @ given if locked else turn.T @ given, atol=1e-9)


def test_a_command_in_an_unknown_frame_is_refused():
    from av_common.stamps import to_stamp
    from av_interfaces.msg import PointingCommand
    rig = Rig()
    command = PointingCommand(move_gimbal=True)
    command.header.frame_id, command.header.stamp = 'map', to_stamp(rig.now.ros)
    with pytest.raises(ValueError, match='map'):
        rig.take('command', command)
