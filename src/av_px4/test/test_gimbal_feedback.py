"""What PX4's gimbal reports becomes the rig's gimbal state, and commands are obeyed in their frame."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_px4_stage import Rig

from av_common.rig import GimbalMount, Mount
from av_common.stamps import to_seconds
from av_interfaces.msg import GimbalState

YAW_LOCK, IN_VEHICLE, IN_EARTH = 16, 32, 64     # MAVLink's GIMBAL_DEVICE_FLAGS
FLIP = Rotation.from_euler('x', 180.0, degrees=True)    # FRD and FLU
VEHICLE = Rotation.from_euler('xyz', [-20.0, 15.0, 130.0], degrees=True)    # FRD to NED
LOOKS = (-40.0, 25.0)    # yaw to the right of the heading, and pitch, deg
NAMES = ('base_link', 'gimbal_link')


def wxyz(rotation):
    return np.roll(rotation.as_quat(), 1).tolist()


def angles(turn):
    """Pitch and yaw (deg, MAVLink's) of a rotation of FRD's x axis."""
    x, y, z = turn.apply([1.0, 0.0, 0.0])
    return math.degrees(math.atan2(-z, math.hypot(x, y))), math.degrees(math.atan2(y, x))


def report(flags, yaw_deg, pitch_deg, time=50.0, **changes):
    """MAVLink: roll and pitch from the horizon, yaw to the right of north or of the heading."""
    q = Rotation.from_euler('xyz', [0.0, pitch_deg, yaw_deg], degrees=True)
    usual = {'timestamp': round(1e6 * time), 'device_flags': flags, 'q': wxyz(q), 'failure_flags': 0,
             'received_from_mavlink': True}
    return SimpleNamespace(**usual | changes)


def reporting(flags, yaw, pitch, attitude=VEHICLE, gimbal=None, **changes):
    """A rig whose gimbal has reported for 2 s while it was not to move."""
    rig = Rig(gimbal)
    rig.attitude = wxyz(attitude)
    for _ in range(100):
        rig.run(0.02, move_gimbal=False)
        rig.take('gimbal_device_attitude_status', report(flags, yaw, pitch, rig.time, **changes))
    return rig


def begins(rig):
    """Pitch and yaw (deg) of the first command after a claim."""
    rig.run(0.02)
    rig.acknowledge()
    claimed = rig.time
    rig.run(0.04)
    first = next(message for message in rig.of('vehicle_command', since=claimed) if message.command == 1000)
    return first.param1, first.param2


@pytest.mark.parametrize(('flags', 'yaw'), [
    (12 + IN_VEHICLE, -40.0), (12, -40.0), (IN_EARTH, 90.0), (YAW_LOCK, 90.0), (YAW_LOCK + IN_VEHICLE, -40.0)])
def test_the_gimbal_looks_where_it_reports_from_a_vehicle_that_tilts(flags, yaw):
    """At heading 130, 40 deg to the left is 90 deg from north: the east."""
    rig = reporting(flags, yaw, 25.0)
    state = rig.of('gimbal/state')[-1]
    q = state.orientation
    body = Rotation.from_quat([q.x, q.y, q.z, q.w])
    truth = VEHICLE.inv() * Rotation.from_euler('xyz', [0.0, 25.0, 90.0], degrees=True)    # in FRD
    assert (body * (FLIP * truth * FLIP).inv()).magnitude() == pytest.approx(0.0, abs=1e-6)
    assert (state.source, state.header.frame_id, state.child_frame_id) == (GimbalState.SOURCE_FEEDBACK, *NAMES)
    assert to_seconds(state.header.stamp) == pytest.approx(rig.now.ros, abs=1e-3)


@pytest.mark.parametrize('measured', [True, False])
@pytest.mark.parametrize('stabilized', [True, False])
@pytest.mark.parametrize('rpy', [(0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 0.0, 90.0)])
def test_a_claim_begins_where_the_gimbal_is_whatever_its_mount(rpy, stabilized, measured):
    """From a vehicle that tilts. What PX4 reports for a gimbal on PWM outputs is its setpoint: no measurement, but this."""
    rig = reporting(IN_VEHICLE, *LOOKS, gimbal=GimbalMount(
        mount=Mount(rpy_deg=rpy), stabilized=stabilized, tilt_limits_deg=(-60.0, 60.0)), received_from_mavlink=measured)
    level = Rotation.from_euler('z', VEHICLE.as_euler('ZYX')[0])
    body = VEHICLE.inv() * level * Rotation.from_euler('xyz', [0.0, LOOKS[1], LOOKS[0]], degrees=True)
    assert begins(rig) == pytest.approx(LOOKS[::-1] if stabilized else angles(body), abs=1.0)
    assert bool(rig.of('gimbal/state')) == measured


def test_an_old_report_is_not_where_a_claim_begins():
    """It would have the gimbal jump back there."""
    rig = reporting(IN_VEHICLE, *LOOKS, attitude=Rotation.identity())
    rig.point(2.0, pan=1.0)
    rig.stage.gimbal.release()
    assert begins(rig) == pytest.approx((0.0, -math.degrees(1.0)), abs=1.0)


@pytest.mark.parametrize('changes', [
    {'q': [math.nan, 0.0, 0.0, 0.0]}, {'q': [0.5, 0.0, 0.0, 0.0]}, {'q': [0.0] * 4}, {'failure_flags': 8},
    {'failure_flags': 256}, {'device_flags': IN_EARTH + IN_VEHICLE}])
def test_the_impossible_is_refused(changes):
    with pytest.raises(ValueError, match='.'):
        reporting(0, 0.0, 0.0, **changes)


def test_without_a_fresh_attitude_nothing_is_said():
    rig = reporting(IN_VEHICLE, *LOOKS)
    assert len(rig.of('gimbal/state')) > 40
    rig.silent, began = {'vehicle_odometry'}, rig.time
    for _ in range(50):
        rig.run(0.02)
        rig.take('gimbal_device_attitude_status', report(IN_VEHICLE, *LOOKS, rig.time))
    assert not rig.of('gimbal/state', began + 0.3)


@pytest.mark.parametrize('frame', ['base_stabilized', 'base_link'])
@pytest.mark.parametrize('stabilized', [True, False])
def test_a_command_is_obeyed_in_its_frame(frame, stabilized):
    """From a nose that is pitched down; MAVLink's angles are from the horizon or from the vehicle, as the gimbal is."""
    rig = Rig(GimbalMount(stabilized=stabilized))
    nose_down = Rotation.from_euler('y', -20.0, degrees=True)
    rig.attitude = wxyz(nose_down)
    rig.point(2.0, frame, pan=math.radians(10.0), tilt=math.radians(30.0))
    given = Rotation.from_euler('xyz', [0.0, 30.0, -10.0], degrees=True)
    if stabilized != (frame == 'base_stabilized'):
        given = (nose_down if stabilized else nose_down.inv()) * given
    last = rig.of('vehicle_command')[-1]
    assert (last.param1, last.param2) == pytest.approx(angles(given), abs=0.1)
    assert last.param5 == (12.0 if stabilized else 0.0)


def test_a_command_in_an_unknown_frame_is_refused():
    with pytest.raises(ValueError, match='map'):
        Rig().run(0.02, 'map')
