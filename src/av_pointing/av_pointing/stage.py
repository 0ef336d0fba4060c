"""The pointing stage: bearings, odometry and their times of arrival in, commands for gimbal and body out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32

from av_common.angles import direction_to_angles
from av_common.cue import cue_direction
from av_common.frames import BASE_FRAME, attitude_of, is_orientation
from av_common.freshness import FUTURE_S, REMEMBERED, CaptureClock, FreshInput, Instant
from av_common.rig import GimbalMount
from av_common.stamps import to_seconds, to_stamp
from av_common.stopping import OLDEST_MEASUREMENT_S, STOP_WITHIN
from av_common.track import State, Track
from av_common.track_messages import track_of_bearing
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.controller import Ages, Look, PointingController
from av_pointing.settings import pointing_settings


class PointingStage:
    """Gives a command for each bearing, and at any time by `on_time`.

    Ages count from the arrival on by the steady clock (see `Instant`). What keeps the body moving is new data only: bearings
    whose `measured` advances, and odometry whose stamp does. One whose `measured` is 0 moves no gimbal either. A topic with two
    publishers is not used (see `Publishers`): a forged bearing would renew the age of what is genuine. Meanwhile the gimbal
    obeys no cue either.

    Attributes:
        controller: computes the commands; `controller.enabled` decides whether they move anything.
        command: the newest command, None before the first.
        contested: publishers of each input that has several.

    Parameters:
        controller: see the attribute.
    """

    def __init__(self, controller: PointingController) -> None:
        self.controller = controller
        self.command: PointingCommand | None = None
        self._track: Track | None = None
        self._arrived, self._late = -math.inf, math.inf  # of the newest bearing: arrival (steady) and age then
        self._stated: dict[float, tuple[float, float]] = {}  # by `measured`: when it was first stated and captured (steady)
        self._clock = CaptureClock()
        self._measured, self._odometry, self._cued = (FreshInput(latency, self._clock) for latency in (math.inf, 0.0, math.inf))
        self._cue: Look | None = None
        self.contested: Mapping[str, list[str]] = {}

    @property
    def refused(self) -> int:
        """Number of inputs whose stamps were in the future, or that arrived as the node's clock stepped back."""
        return self._measured.refused + self._odometry.refused + self._cued.refused

    def on_bearing(self, message: Bearing, arrival: Instant) -> PointingCommand:
        """The command that follows from a bearing.

        Parameters:
            message: the bearing.
            arrival: time of its arrival.
        """
        track = track_of_bearing(message)
        if 'target/bearing' in self.contested:
            self._measured.skip(track.measured, arrival)
            return self.on_time(arrival)
        self._track = track
        ahead = track.time - arrival.ros
        self._arrived, self._late = arrival.steady, ahead if ahead > FUTURE_S else max(-ahead, 0.0)
        self._stated.setdefault(track.measured, (arrival.steady, self._clock.captured(track.measured, arrival)))
        while len(self._stated) > REMEMBERED and next(iter(self._stated)) != track.measured:
            del self._stated[next(iter(self._stated))]
        if track.state != State.NONE:
            self._measured.take(track.measured, arrival)
        return self.on_time(arrival)

    def on_odometry(self, message: Odometry, arrival: Instant) -> None:
        """Note a pose of the rig, without which the body does not move; one without attitude does not count.

        Parameters:
            message: pose of the rig.
            arrival: time of its arrival.
        """
        attitude, stamp = attitude_of(message.pose.pose.orientation), to_seconds(message.header.stamp)
        if 'odometry' in self.contested or not is_orientation(attitude):
            self._odometry.skip(stamp, arrival)
        elif self._odometry.take(stamp, arrival):
            age = max(arrival.ros - stamp, 0.0)
            self.controller.on_attitude(arrival.steady - age, attitude)

    def on_yaw_rate_limit(self, message: Float32) -> None:
        """Note the largest yaw rate (rad/s) that whoever obeys the commands lets through. Raises ValueError for none."""
        if 'yaw_rate_limit' not in self.contested:
            if not math.isfinite(message.data):
                raise ValueError(f'a limit of {message.data} rad/s, expected a finite one')
            self.controller.limit_body(message.data)

    def on_limiters(self, number: int) -> None:
        """Note the number of publishers of yaw_rate_limit: a limit ends with the last of them."""
        if not number:
            self.controller.limit_body(math.inf)

    def on_cue(self, message: PointStamped, arrival: Instant) -> None:
        """Note where others say that a target is. Raises ValueError for a place that is none.

        Parameters:
            message: the place, seen from the rig in the body's frame, or with the axes of the world.
            arrival: time of its arrival.
        """
        azimuth, elevation = map(float, direction_to_angles(cue_direction(message)))
        stamp = to_seconds(message.header.stamp)
        if 'target/cue' in self.contested:
            self._cued.skip(stamp, arrival)
        elif self._cued.take(stamp, arrival):
            self._cue = Look(azimuth, elevation, message.header.frame_id == BASE_FRAME)

    def on_time(self, now: Instant) -> PointingCommand:
        """The command at `now`, from the newest bearing while it is not stale."""
        self._clock.note(now)
        ages = Ages(now.steady - self._arrived + self._late, self._measured.age(now), self._odometry.age(now), self._late,
                    self._measured.captured_age(now), self._cued.age(now), self._cued.captured_age(now),
                    self._is_supported(now))
        self.command = self.controller.step(now.steady, self._track, ages, None if self.contested else self._cue)
        self.command.header.stamp = to_stamp(now.ros)
        return self.command

    def _is_supported(self, now: Instant) -> bool:
        """Whether the newest bearing rests on a measurement.

        One that is older than another one that was stated before, as where another track is followed, must be young by itself.
        """
        track, captured = self._track, self._measured.captured_age(now)
        if track is None or not track.measured > 0.0:
            return False
        stated, own = self._stated[track.measured]
        young = now.steady - stated < STOP_WITHIN and now.steady - own < OLDEST_MEASUREMENT_S
        return now.steady - own <= captured or young


def make_pointing_stage(parameters: Any, gimbal: GimbalMount | None = None) -> PointingStage:
    """A stage from the parameters of pointing_node. Raises ValueError for a body that would never follow.

    Parameters:
        parameters: the node's parameters.
        gimbal: the rig's gimbal, None where it has none.
    """
    controller = PointingController(pointing_settings(parameters, gimbal))
    controller.enabled = parameters.enabled
    return PointingStage(controller)
