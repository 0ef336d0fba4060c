"""Looks of the gimbal, and a gimbal on a body that tilts."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from transforms3d.euler import euler2quat
from transforms3d.quaternions import quat2mat

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.freshness import Instant
from av_common.limited_axis import AxisLimits
from av_common.rig import GimbalMount, Mount
from av_common.stamps import to_stamp
from av_common.track import Source, State, Track
from av_common.track_messages import bearing_message
from av_interfaces.msg import PointingCommand
from av_pointing import PointingController, PointingStage
from av_pointing.settings import PointingSettings

STEP = 1.0 / 30.0
LOOK = (math.radians(120.0), math.radians(20.0))


class Rig:
    """A stage, odometry and bearings."""

    def __init__(self, gimbal=None, **settings):
        self.stage = PointingStage(PointingController(PointingSettings(gimbal or GimbalMount(), **settings)))
        self.now, self.attitude, self.commands = Instant(50.0, 1.7e9), (1.0, 0.0, 0.0, 0.0), []

    def run(self, seconds, measured=True, bearings=True, **track):
        for _ in range(round(seconds / STEP)):
            self.now = Instant(self.now.steady + STEP, self.now.ros + STEP)
            odometry = Odometry()
            odometry.header.stamp = to_stamp(self.now.ros)
            q = odometry.pose.pose.orientation
            q.w, q.x, q.y, q.z = map(float, self.attitude)
            self.stage.on_odometry(odometry, self.now)
            if measured:
                self.newest = self.now.ros
            if bearings:
                fields = {'state': State.ACOUSTIC_ACTIVE, 'source': Source.SOUND, 'azimuth': 1.0, 'azimuth_variance': 0.001,
                          'azimuth_world': 1.0, 'attitude_known': True} | track
                message = bearing_message(Track(self.now.ros, measured=self.newest, **fields), 'base_link')
                self.commands.append(self.stage.on_bearing(message, self.now))
            else:
                self.commands.append(self.stage.on_time(self.now))
        return self.commands[-1]

    def sight(self, command):
        """Line of sight in the world of a stabilized gimbal."""
        matrix = quat2mat(self.attitude)
        return angles_to_direction(command.pan + math.atan2(matrix[1, 0], matrix[0, 0]), command.tilt)


def test_the_gimbal_looks_and_the_body_stands_still_although_a_turn_is_requested():
    rig = Rig()
    command = rig.run(3.0, look=LOOK, requested_rotation=0.5)
    assert command.mode == PointingCommand.MODE_LOOK
    assert command.header.frame_id == 'base_stabilized'
    assert (command.pan, command.tilt) == pytest.approx(LOOK, abs=math.radians(0.6))
    assert {each.yaw_rate for each in rig.commands} == {0.0}


def test_the_body_turns_when_looks_are_exhausted():
    rig = Rig()
    rig.run(1.0, look=LOOK, requested_rotation=0.5)
    command = rig.run(0.5, requested_rotation=0.5)
    assert command.mode == PointingCommand.MODE_SEARCH
    assert command.yaw_rate > 0.1


def test_a_turning_body_brakes_for_a_look():
    rig = Rig()
    assert rig.run(1.0, requested_rotation=0.5).yaw_rate > 0.1
    assert rig.run(1.0, look=LOOK, requested_rotation=0.5).yaw_rate == 0.0


@pytest.mark.parametrize('look', [None, (math.nan, 0.0), (math.inf, 0.0)])
def test_without_a_possible_look_the_body_turns(look):
    assert Rig().run(0.5, look=look, requested_rotation=0.5).mode == PointingCommand.MODE_SEARCH


def test_a_gimbal_that_is_not_to_move_does_not_look():
    assert Rig(move_gimbal=False).run(0.5, look=LOOK, requested_rotation=0.5).mode == PointingCommand.MODE_SEARCH


def test_looks_need_fresh_bearings_and_end_with_the_measurements():
    rig = Rig()
    rig.run(1.0, look=LOOK)
    rig.run(1.5, look=LOOK, bearings=False)
    stopped = rig.commands[-20:]
    assert stopped[-1].mode == PointingCommand.MODE_HOLD
    assert len({(each.pan, each.tilt) for each in stopped}) == 1
    rig = Rig()
    rig.run(0.3, look=LOOK)
    rig.run(3.0, measured=False, look=LOOK)
    stopped = rig.commands[-20:]
    assert stopped[-1].mode == PointingCommand.MODE_HOLD
    assert len({(each.pan, each.tilt) for each in stopped}) == 1


@pytest.mark.parametrize('hostile', [
    {'elevation_world': math.nan}, {'elevation_world_rate': math.nan}, {'elevation_world_rate': math.inf},
    {'elevation': math.nan}, {'look': (1e30, -1e30)}, {'look': (math.nan, 0.0), 'elevation_variance': math.inf}])
@pytest.mark.parametrize('stabilized', [True, False])
def test_hostile_directions_give_commands_within_the_limits(hostile, stabilized):
    rig = Rig(GimbalMount(stabilized=stabilized))
    for resolved in (True, False):
        rig.run(1.0, **{'resolved': resolved, 'elevation_variance': 1e-4, 'elevation': 0.1} | hostile)
    assert all(math.isfinite(each.pan + each.tilt + each.pan_rate + each.tilt_rate + each.yaw_rate) for each in rig.commands)
    assert all(each.tilt <= math.radians(60.0) for each in rig.commands)


def test_a_disabled_rig_looks_nowhere():
    rig = Rig()
    rig.stage.controller.enabled = False
    command = rig.run(1.0, look=LOOK)
    assert not (command.move_gimbal or command.move_body)
    assert (command.mode, command.pan, command.tilt) == (PointingCommand.MODE_HOLD, 0.0, 0.0)


def test_a_look_from_a_tilted_body_is_turned_level():
    rig = Rig()
    rig.attitude = euler2quat(*np.radians([20.0, -15.0, 70.0]), 'sxyz')
    command = rig.run(3.0, look=LOOK)
    assert np.allclose(rig.sight(command), quat2mat(rig.attitude) @ angles_to_direction(*LOOK), atol=0.02)


def test_the_gimbal_keeps_to_the_target_as_the_body_tilts():
    """A body that rolls and pitches by 25 degrees; a target that is still."""
    direction = angles_to_direction(math.radians(40.0), math.radians(20.0))
    errors = []
    rig = Rig(move_body=False)
    rig.stage.controller.gimbal._dead_band = 0.0
    for step in range(150):
        tilt = math.radians(25.0) * math.sin(0.08 * step)
        rig.attitude = euler2quat(tilt, -0.6 * tilt, 0.3, 'sxyz')
        azimuth, elevation = map(float, direction_to_angles(quat2mat(rig.attitude).T @ direction))
        world = tuple(map(float, direction_to_angles(direction)))
        command = rig.run(STEP, azimuth=azimuth, elevation=elevation, elevation_variance=1e-4, azimuth_world=world[0],
                          elevation_world=world[1], resolved=True, state=State.VISUAL_ACTIVE)
        errors.append(math.degrees(math.acos(min(rig.sight(command) @ direction, 1.0))))
    assert max(errors[60:]) < 0.5


@pytest.mark.parametrize('stabilized', [True, False])
def test_without_odometry_the_body_counts_as_level_and_bearings_are_in_its_frame(stabilized):
    """It ended while the body was banked and turned: the gimbal looks where fusion says from then on."""
    rig = Rig(GimbalMount(stabilized=stabilized))
    rig.attitude = euler2quat(math.radians(30.0), 0.0, 2.0, 'sxyz')
    rig.run(1.0, resolved=True, azimuth_world=3.0, elevation_variance=1e-4)
    rig.attitude = (0.0, 0.0, 0.0, 0.0)
    rig.run(1.0, resolved=True, azimuth_world=3.0, elevation_variance=1e-4)
    command = rig.run(3.0, resolved=True, azimuth=1.0, azimuth_world=0.4, elevation=0.1, elevation_variance=1e-4,
                      attitude_known=False)
    assert (command.pan, command.tilt) == pytest.approx((1.0, 0.1), abs=math.radians(0.6))


def test_a_gimbal_does_not_jerk_after_a_pause_of_the_process():
    """A turned body: bearings are used after odometry of the present, whose heading must count."""
    rig = Rig(move_body=False)
    rig.attitude = euler2quat(0.0, 0.0, 2.0, 'sxyz')
    before = rig.run(2.0, resolved=True, azimuth_world=3.0)
    rig.now = Instant(rig.now.steady + 3.0, rig.now.ros + 3.0)
    command = rig.run(2.0 * STEP, resolved=True, azimuth_world=3.0)
    assert command.mode == PointingCommand.MODE_TRACK and command.pan == pytest.approx(before.pan, abs=math.radians(0.6))
    assert abs(command.pan_rate) < math.radians(1.0)


def test_a_target_of_unknown_elevation_is_looked_for_up_and_down_where_it_is_heard():
    rig = Rig()
    command = rig.run(3.0, resolved=True, elevation_variance=math.inf, look=(1.0, math.radians(30.0)))
    assert command.mode == PointingCommand.MODE_TRACK
    assert command.tilt == pytest.approx(math.radians(30.0), abs=math.radians(0.6))


def test_the_camera_visits_another_target_within_its_limits_and_the_body_follows_the_bearing():
    """Looks change from one side to the other: rate and acceleration stay within the limits."""
    rig, pan = Rig(), AxisLimits(math.radians(120), math.radians(360), -2.6, 2.6)
    for azimuth in (0.8, -0.6, 0.8):
        command = rig.run(1.5, resolved=True, azimuth=1.0, azimuth_world=1.0, look=(azimuth, 0.2))
        assert command.mode == PointingCommand.MODE_TRACK and command.yaw_rate > 0.0
        assert (command.pan, command.tilt) == pytest.approx((azimuth, 0.2), abs=math.radians(0.6))
    rates = np.diff([command.pan for command in rig.commands]) / STEP
    assert np.abs(rates).max() <= pan.rate + 1e-6
    assert np.abs(np.diff(rates) / STEP).max() <= 1.5 * pan.acceleration  # of finite differences


def test_the_frame_is_that_of_the_gimbal():
    assert Rig(GimbalMount(stabilized=False)).run(0.1).header.frame_id == 'base_link'


MOUNTS = {'upright': (0.0, 0.0, 0.0), 'upside down': (180.0, 0.0, 0.0), 'to the left': (0.0, 0.0, 90.0),
          'to the rear': (0.0, 0.0, 180.0), 'upside down to the rear': (180.0, 0.0, 180.0), 'nose down': (0.0, 20.0, 0.0)}
LIMITS = {'pan_limits_deg': (-100.0, 100.0), 'tilt_limits_deg': (-30.0, 60.0)}


@pytest.mark.parametrize('stabilized', [True, False])
@pytest.mark.parametrize('rpy', MOUNTS.values(), ids=MOUNTS)
def test_a_gimbal_looks_wherever_its_mount_allows_and_nowhere_else(rpy, stabilized):
    """Pan and tilt are limited about the mount's axes; the command is a direction from the body, which is tilted, or level."""
    body, mount = Rotation.from_euler('xyz', [12.0, -8.0, 70.0], degrees=True), Rotation.from_euler('xyz', rpy, degrees=True)
    level = body.inv() * Rotation.from_euler('z', body.as_euler('ZYX')[0])
    carrier = (level if stabilized else Rotation.identity()) * mount
    for pan, tilt in ((85.0, 50.0), (-85.0, -20.0), (40.0, -20.0), (-10.0, 20.0), (170.0, 20.0), (0.0, -70.0)):
        rig = Rig(GimbalMount(mount=Mount(rpy_deg=rpy), stabilized=stabilized, **LIMITS), move_body=False)
        rig.attitude = np.roll(body.as_quat(), 1)
        target = carrier.apply(Rotation.from_euler('ZY', [pan, -tilt], degrees=True).apply([1.0, 0.0, 0.0]))
        (azimuth, elevation), (world, raised) = direction_to_angles(target), direction_to_angles(body.apply(target))
        command = rig.run(4.0, resolved=True, azimuth=float(azimuth), elevation=float(elevation), elevation_variance=1e-4,
                          azimuth_world=float(world), elevation_world=float(raised))
        sight = angles_to_direction(command.pan, command.tilt)
        reached = np.degrees(direction_to_angles(mount.inv().apply(sight)))
        assert abs(reached[0]) < 100.1 and -30.1 < reached[1] < 60.1
        if abs(pan) < 100.0 and tilt > -30.0:
            assert (level.apply(sight) if stabilized else sight) @ target > math.cos(math.radians(1.0))


@pytest.mark.parametrize(('limit', 'seen'), [(180.0, True), (170.0, True), (150.0, False)])
@pytest.mark.parametrize('swing', [0.0, 5.0])
def test_a_target_at_the_stops_does_not_send_the_gimbal_round(limit, seen, swing):
    """Behind the rig, at rest or to and fro, with noise of 2 deg: the camera stays at a stop, within half of its view of it."""
    random, off, pans = np.random.default_rng(3), [], []
    rig = Rig(GimbalMount(pan_limits_deg=(-limit, limit)), move_body=False)
    for step in range(450):
        azimuth = math.radians(180.0 + swing * math.sin(step * STEP) + 2.0 * random.standard_normal())
        azimuth = math.remainder(azimuth, math.tau)
        command = rig.run(STEP, resolved=True, azimuth=azimuth, azimuth_world=azimuth)
        off.append(abs(math.remainder(azimuth - command.pan, math.tau)))
        pans.append(command.pan)
    assert np.degrees(np.ptp(pans[120:])) < 30.0
    assert not seen or np.degrees(max(off[120:])) < 25.0


@pytest.mark.parametrize(('limit', 'azimuths', 'end'), [
    (150.0, (100.0,), 100.0), (150.0, (170.0,), 150.0), (150.0, (-170.0,), -150.0), (270.0, (170.0,), 170.0),
    (270.0, (170.0, -170.0), 190.0)])
def test_pan_goes_to_the_nearest_allowed_angle(limit, azimuths, end):
    """One with room follows beyond half a turn."""
    rig = Rig(GimbalMount(pan_limits_deg=(-limit, limit)), move_body=False)
    for azimuth in azimuths:
        command = rig.run(4.0, resolved=True, azimuth=math.radians(azimuth), azimuth_world=math.radians(azimuth))
    assert math.degrees(command.pan) == pytest.approx(end, abs=0.6)


def test_straight_up_pan_stands_still():
    rig = Rig(GimbalMount(tilt_limits_deg=(-45.0, 90.0)))
    assert rig.run(4.0, look=(1.7, math.radians(90.0))).pan == 0.0


@pytest.mark.parametrize('neutral', [True, False])
def test_without_bearings_the_gimbal_stops_or_returns_to_the_middle(neutral):
    """`on_stale` neutral returns pan and tilt to 0, in no mode in which nothing moves."""
    rig = Rig(neutral=neutral, move_body=False)
    before = rig.run(2.0, resolved=True, elevation=0.4, elevation_world=0.4, elevation_variance=0.01)
    assert (before.pan, before.tilt) == pytest.approx((1.0, 0.4), abs=0.02)
    command = rig.run(4.0, bearings=False)
    ends = ((0.0, 0.0), PointingCommand.MODE_LOOK) if neutral else ((before.pan, before.tilt), PointingCommand.MODE_HOLD)
    assert (command.pan, command.tilt) == pytest.approx(ends[0], abs=0.02) and command.mode == ends[1]
    rig.stage.controller.enabled = False
    assert rig.run(STEP, bearings=False).mode == PointingCommand.MODE_HOLD


@pytest.mark.parametrize(('sigma_deg', 'limit'), [(5.0, 2.0), (25.0, 0.3)])
def test_the_gimbal_follows_a_prediction_ever_slower_to_its_limit(sigma_deg, limit):
    """Of time or of sigma; then it holds, and the reason says so. The body has stood still since 0.3 s."""
    rig = Rig()
    rig.run(0.1, resolved=True)
    rates = []
    for step in range(1, 75):
        age, azimuth = step * STEP, 2.5 * math.sin(step * STEP)
        command = rig.run(STEP, measured=False, state=State.COASTING, resolved=True, azimuth=azimuth, azimuth_world=azimuth,
                          azimuth_variance=math.radians(sigma_deg) ** 2)
        rates.append(abs(command.pan_rate))
        assert rates[-1] <= math.radians(120.0) * max(1.0 - 0.5 * age, 0.0) + math.radians(360.0) * STEP or sigma_deg > 20.0
        assert command.yaw_rate == 0.0 or age < 0.3
        if abs(age - limit) > STEP:
            assert command.mode == (PointingCommand.MODE_TRACK if age < limit else PointingCommand.MODE_HOLD)
        assert age < 0.35 or 'prediction' in command.reason
    assert rates[20] > 0.1 or sigma_deg > 20.0
    assert max(rates[round(limit / STEP) + 12:]) == 0.0


@pytest.mark.parametrize(('obeys', 'rpy'), [(0.0, MOUNTS['upright']), (0.5, MOUNTS['upright']), (1.0, MOUNTS['upright']),
                                            (0.0, MOUNTS['upside down'])])
def test_the_gimbal_follows_however_the_body_obeys(obeys, rpy):
    """A vehicle whose pilot has not handed over stands still while the body is commanded: the gimbal does not count on it.

    Commands are 0.05 s ahead, the lag of a gimbal.
    """
    rig, yaw, errors = Rig(GimbalMount(mount=Mount(rpy_deg=rpy))), 0.0, []
    for step in range(240):
        target = math.radians(-60.0 + 20.0 * step * STEP)
        rig.attitude = euler2quat(0.0, 0.0, yaw, 'sxyz')
        command = rig.run(STEP, state=State.VISUAL_ACTIVE, azimuth=math.remainder(target - yaw, math.tau),
                          azimuth_world=math.remainder(target, math.tau), azimuth_world_rate=math.radians(20.0))
        ahead = 0.05 * (math.radians(20.0) - obeys * command.yaw_rate)
        errors.append(abs(math.remainder(target + ahead - yaw - command.pan, math.tau)))
        yaw += obeys * command.yaw_rate * STEP
    assert math.degrees(max(errors[120:])) < 2.0
