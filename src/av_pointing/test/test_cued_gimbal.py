"""The gimbal turns to where others have a target, while it is told so, and nothing else moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from av_common.freshness import Instant
from av_common.rig import GimbalMount
from av_common.stamps import to_stamp
from av_common.track import Source, State, Track
from av_common.track_messages import bearing_message
from av_interfaces.msg import PointingCommand
from av_pointing import PointingController, PointingStage
from av_pointing.settings import PointingSettings

STEP = 1.0 / 30.0
YAW = math.radians(30.0)
PLACE = np.array([20.0, 25.0, 12.0])  # azimuth 51 deg, elevation 21 deg in the world


class Rig:
    """A stage whose body stands at YAW, with cues and no target of its own."""

    def __init__(self, gimbal=None, **settings):
        self.stage = PointingStage(PointingController(PointingSettings(gimbal or GimbalMount(), **settings)))
        self.now, self.commands = Instant(50.0, 1.7e9), []

    def run(self, seconds, cue=True, frame='rig/world', odometry=True, late=0.0, place=PLACE, track=None):
        for _ in range(round(seconds / STEP)):
            self.now = Instant(self.now.steady + STEP, self.now.ros + STEP)
            if odometry:
                pose = Odometry(header=Header(stamp=to_stamp(self.now.ros)))
                pose.pose.pose.orientation.w, pose.pose.pose.orientation.z = math.cos(0.5 * YAW), math.sin(0.5 * YAW)
                self.stage.on_odometry(pose, self.now)
            if cue:
                x, y, z = map(float, place)
                self.stage.on_cue(PointStamped(header=Header(stamp=to_stamp(self.now.ros - late), frame_id=frame),
                                               point=Point(x=x, y=y, z=z)), self.now)
            fields = track or {'state': State.NONE}
            message = bearing_message(Track(self.now.ros, measured=self.now.ros, **fields), 'base_link')
            self.commands.append(self.stage.on_bearing(message, self.now))
        return self.commands[-1]


def test_the_gimbal_turns_to_the_cue_and_the_body_stands_still():
    """By the direction in the world, less the body's heading."""
    rig = Rig()
    command = rig.run(3.0)
    assert command.mode == PointingCommand.MODE_LOOK and 'cue' in command.reason
    assert command.pan == pytest.approx(math.atan2(PLACE[1], PLACE[0]) - YAW, abs=math.radians(1.0))
    assert command.tilt == pytest.approx(math.atan2(PLACE[2], math.hypot(*PLACE[:2])), abs=math.radians(1.0))
    assert all(each.yaw_rate == 0.0 for each in rig.commands)


def test_limits_of_angle_and_rate_hold():
    """A cue behind the stops: the gimbal stays within them, and no faster than it may."""
    rig = Rig(GimbalMount(max_rate_deg=40.0, pan_limits_deg=(-57.0, 57.0)))
    rig.run(5.0, place=(-30.0, 5.0, 4.0))
    pans = np.array([each.pan for each in rig.commands])
    assert np.all(np.abs(pans) <= math.radians(57.0) + 1e-9)
    assert np.max(np.abs(np.diff(pans))) <= math.radians(40.0) * STEP + 1e-9


@pytest.mark.parametrize('values', [{'cue': False}, {'late': 1.2}, {'late': -0.5}, {'odometry': False}])
def test_nothing_moves_on_what_is_old(values):
    """No cues any more, cues that are old or from the future, a heading that is not known any more."""
    rig = Rig()
    rig.run(1.0, place=(1.0, 0.0, 0.0))
    rig.run(1.0, **values)
    before = rig.commands[-1]
    command = rig.run(2.0, **values)
    assert command.mode == PointingCommand.MODE_HOLD
    assert (command.pan, command.tilt) == pytest.approx((before.pan, before.tilt), abs=1e-6)


def test_a_repeated_cue_is_as_old_as_the_first():
    """The same stamp again and again moves nothing once it is stale."""
    rig = Rig()
    rig.run(0.3)
    old = PointStamped(header=Header(stamp=to_stamp(rig.now.ros), frame_id='rig/world'), point=Point(x=1.0, y=-20.0, z=3.0))
    for _ in range(60):
        rig.stage.on_cue(old, rig.now)
        rig.run(STEP, cue=False)
    assert rig.commands[-1].mode == PointingCommand.MODE_HOLD


def test_a_cue_of_two_publishers_is_not_obeyed_later_either():
    """The last one may be the forger's, who has gone."""
    rig = Rig()
    rig.run(1.0, place=(1.0, 0.0, 0.0))
    rig.stage.contested = {'target/cue': ['/network_node', '/forger']}
    before = rig.run(0.5)
    rig.stage.contested = {}
    assert rig.run(0.2, cue=False).pan == pytest.approx(before.pan)
    assert rig.run(1.0).pan > before.pan + 0.2


def test_a_target_of_its_own_comes_first():
    """Cues count only without one."""
    seen = {'state': State.VISUAL_ACTIVE, 'source': Source.SIGHT, 'azimuth': -0.3, 'azimuth_variance': 1e-3, 'resolved': True}
    command = Rig().run(2.0, track=seen)
    assert command.mode == PointingCommand.MODE_TRACK


def test_a_rig_that_is_not_enabled_moves_nothing():
    """Whatever it is told."""
    rig = Rig()
    rig.stage.controller.enabled = False
    command = rig.run(1.0)
    assert command.mode == PointingCommand.MODE_HOLD and not command.move_gimbal and command.pan == 0.0


def test_a_cue_in_the_frame_of_the_body():
    """Its azimuth is from the body's heading."""
    command = Rig().run(3.0, frame='base_link')
    assert command.pan == pytest.approx(math.atan2(PLACE[1], PLACE[0]), abs=math.radians(1.0))


@pytest.mark.parametrize('place', [(math.nan, 1.0, 0.0), (math.inf, 0.0, 0.0), (0.0, 0.0, 0.0), (1e9, 0.0, 0.0)])
def test_impossible_places_are_refused(place):
    """They raise, and the gimbal stays."""
    rig = Rig()
    with pytest.raises(ValueError, match='cue at'):
        rig.run(STEP, place=place)
    assert rig.run(0.2, cue=False).mode == PointingCommand.MODE_HOLD
