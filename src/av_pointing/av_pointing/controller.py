"""Commands for gimbal and body from a track, within limits of angle, rate and acceleration.

The body moves by measurements only. Its yaw rate is 0 BODY_TIMEOUT_S after the newest measurement of the track, or the newest
odometry, arrived, and what a fast body still turns is braked before (`body_axis.py`). The gimbal may follow a prediction for a
while, the slower the older it is.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import NamedTuple

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.track import State, Track
from av_pointing.body_axis import Aim, BodyAxis
from av_pointing.response import Response

BODY_TIMEOUT_S = 0.3  # after the arrival of the newest measurement, and of the newest odometry, at which the body stands still
LONGEST_STEP_S = 0.1  # longer steps are computed as this long
OLDEST_MEASUREMENT_S = 1.0  # age since its capture from which a measurement moves no body, and a bearing on arrival nothing


class Mode(enum.IntEnum):
    """Mode of a command; the values of `av_interfaces/PointingCommand`."""

    HOLD = 0
    TRACK = 1
    SEARCH = 2


class Ages(NamedTuple):
    """Ages (s) of what a command rests on, at the time of the command; inf for what never arrived.

    Parameters:
        bearing: time since the bearing arrived, and distance of its stamp from that.
        measurement: time since the newest measurement of the bearing arrived.
        odometry: time since the newest odometry arrived.
        late: part of `bearing` that had passed on its arrival.
        captured: time since the newest measurement was captured.
    """

    bearing: float = math.inf
    measurement: float = math.inf
    odometry: float = math.inf
    late: float = 0.0
    captured: float = 0.0

    @property
    def body_left(self) -> float:
        """Time (s) until the body must stand still."""
        return min(BODY_TIMEOUT_S - max(self.measurement, self.odometry), OLDEST_MEASUREMENT_S - self.captured)

    @property
    def predicted(self) -> bool:
        """Whether the bearing is a prediction, without a recent measurement."""
        return self.measurement >= BODY_TIMEOUT_S or self.captured >= OLDEST_MEASUREMENT_S


@dataclass(frozen=True)
class PointingSettings:
    """Settings of `PointingController`.

    Parameters:
        pan, tilt, yaw: limits of the gimbal's axes and of the body's yaw.
        search_rate (rad/s): rate of the body's rotation that resolves the front-back ambiguity.
        dead_band (rad): error below which nothing moves.
        lead (s): time after its stamp for which a bearing is given to the gimbal, or its age where that is larger.
        period (s): longest time between two commands.
        response: expected answer of the vehicle to yaw rates, from which its estimate starts.
        stale_after (s): time since its arrival from which a bearing is stale and moves nothing.
        coast (s): time after the newest measurement's arrival for which the gimbal follows a prediction.
        coast_sigma (rad): standard deviation of a prediction's azimuth up to which the gimbal follows it.
        on_stale: reaction of the gimbal to a stale bearing: 'hold' stops it, 'neutral' returns it to 0.
        move_gimbal, move_body: whether gimbal and body are commanded.
        body_follows_at (rad): pan from which the body follows a moving gimbal.

    Raises ValueError for another `on_stale`.
    """

    pan: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(120), math.radians(360), -2.6, 2.6))
    tilt: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(60), math.radians(180), -1.4, 0.8))
    yaw: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(45), math.radians(360)))
    search_rate: float = math.radians(40.0)
    dead_band: float = math.radians(0.5)
    lead: float = 0.05
    period: float = 1.0 / 30.0
    response: Response = field(default_factory=Response)
    stale_after: float = 0.5
    coast: float = 2.0
    coast_sigma: float = math.radians(20.0)
    on_stale: str = 'hold'
    move_gimbal: bool = True
    move_body: bool = True
    body_follows_at: float = math.radians(30.0)

    def __post_init__(self) -> None:
        if self.on_stale not in ('hold', 'neutral'):
            raise ValueError(f"on_stale is {self.on_stale!r}, expected 'hold' or 'neutral'")


@dataclass(frozen=True)
class Command:
    """A command.

    Parameters:
        mode, reason: mode of the command and its reason.
        pan, tilt (rad), pan_rate, tilt_rate (rad/s): angles and rates of the gimbal in the rig's frame.
        yaw_rate (rad/s): yaw rate of the body, counter-clockwise.
        move_gimbal, move_body: whether gimbal and body follow the command.
    """

    mode: Mode
    reason: str
    pan: float
    tilt: float
    pan_rate: float
    tilt_rate: float
    yaw_rate: float
    move_gimbal: bool
    move_body: bool


class PointingController:
    """Computes commands from tracks; `step` is called at least every `period` s.

    Attributes:
        settings: see `PointingSettings`.
        enabled: whether commands move anything.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: PointingSettings | None = None) -> None:
        self.settings = settings or PointingSettings()
        self.enabled = True
        self._pan, self._tilt = LimitedAxis(self.settings.pan), LimitedAxis(self.settings.tilt)
        self.body = BodyAxis(self.settings.yaw, self.settings.response)
        self._time: float | None = None
        self._seen: Track | None = None
        self._has_odometry = False

    def start_at(self, pan: float, tilt: float) -> None:
        """Stand still at angles of the gimbal (rad), such as those of the controller before, within the limits."""
        for axis, angle in ((self._pan, pan), (self._tilt, tilt)):
            axis.position, axis.velocity = min(max(angle, axis.limits.lower), axis.limits.upper), 0.0

    def on_yaw(self, time: float, yaw: float) -> None:
        """Note the body's yaw (rad) by odometry of `time` (s, on the clock of `step`)."""
        self._has_odometry = True
        self.body.motion.measure(time, yaw)

    def step(self, time: float, track: Track | None, ages: Ages) -> Command:
        """The command from the newest track. Steps back in time count as 0, steps of more than 0.1 s as 0.1 s.

        Parameters:
            time (s): time of the command, monotonic.
            track: the newest track; None before the first.
            ages: of what the track rests on, at that time.
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), LONGEST_STEP_S)
        self._time = time
        self.body.motion.advance(time)
        settings, left = self.settings, ages.body_left - self.settings.period
        mode, reason = self._decide(track, ages)
        if track is not None and track is not self._seen:
            self._see(time, track, ages)
        if track is None or mode == Mode.HOLD:
            self._hold(dt, neutral=self.settings.on_stale == 'neutral' and reason.startswith('no fresh'))
        elif mode == Mode.SEARCH:
            aim = self._aim(time, track, ages)._replace(azimuth=track.requested_rotation, rate=0.0)
            self.body.turn(time, dt, aim, settings.dead_band, ages.measurement, left, settings.search_rate)
            self._pan.stop(dt)
            self._tilt.stop(dt)
        else:
            self._track(time, dt, track, ages)
        yaw_rate = self.body.command(time, left, self.enabled and settings.move_body)
        return Command(mode, reason, self._pan.position, self._tilt.position, self._pan.velocity, self._tilt.velocity,
                       yaw_rate, self.enabled and settings.move_gimbal, self.enabled and settings.move_body)

    def _decide(self, track: Track | None, ages: Ages) -> tuple[Mode, str]:
        settings = self.settings
        if not self.enabled:
            return Mode.HOLD, 'disabled'
        if track is None or not ages.bearing - ages.late <= settings.stale_after or not ages.late <= OLDEST_MEASUREMENT_S:
            return Mode.HOLD, 'no fresh bearing'
        if track.state == State.NONE or not (math.isfinite(track.azimuth) and math.isfinite(track.azimuth_world_rate)):
            return Mode.HOLD, 'no fresh bearing: no target'
        predicted = ages.predicted
        if ages.measurement >= settings.coast or (predicted and not 0.0 <= track.azimuth_variance <= settings.coast_sigma**2):
            return Mode.HOLD, 'no fresh bearing: a prediction without recent measurements'
        may_move = ages.body_left > 0.0
        stands = f'the body stands still without recent {"measurements" if predicted else "odometry"}'
        if track.resolved or track.state == State.VISUAL_ACTIVE:
            if may_move or not settings.move_body:
                return Mode.TRACK, 'following a prediction' if predicted else 'following the bearing'
            if settings.move_gimbal:
                return Mode.TRACK, f'the gimbal follows {"a prediction" if predicted else "the bearing"}, {stands}'
            return Mode.HOLD, stands
        if math.isfinite(track.requested_rotation) and track.requested_rotation != 0.0 and settings.move_body:
            if not may_move:
                return Mode.HOLD, stands
            return Mode.SEARCH, f'turning {math.degrees(track.requested_rotation):+.0f} deg to resolve the front-back ambiguity'
        return Mode.HOLD, 'waiting: the front-back ambiguity is open'

    def _see(self, time: float, track: Track, ages: Ages) -> None:
        """Learn from a new track how old bearings are, and without odometry how the body turns."""
        self._seen = track
        if track.state == State.NONE or not math.isfinite(ages.bearing + track.azimuth + track.azimuth_world_rate):
            return
        if not self._has_odometry:
            self.body.motion.measure(time - ages.bearing, track.azimuth_world - track.azimuth)
        predicted = track.time - track.measured if track.measured > 0.0 else 0.0
        self.body.see(self._aim(time, track, ages), ages.late + max(predicted, 0.0))

    def _aim(self, time: float, track: Track, ages: Ages) -> Aim:
        """The direction of a track, by its direction in the world where the attitude is known."""
        seen = time - ages.bearing
        known = track.attitude_known and self._has_odometry and math.isfinite(track.azimuth_world)
        azimuth = float(wrap(track.azimuth_world - self.body.motion.yaw(seen))) if known else track.azimuth
        return Aim(azimuth, track.azimuth_world_rate, seen)

    def _track(self, time: float, dt: float, track: Track, ages: Ages) -> None:
        settings, body, aim = self.settings, self.body, self._aim(time, track, ages)
        left = settings.coast - ages.measurement  # of the gimbal's motion, which slows down until then
        slowed = min(left / settings.coast * settings.pan.rate, left * settings.pan.acceleration)
        body_rate = body.motion.rate(time)
        seen_rate = aim.rate - body_rate
        if settings.move_gimbal:
            ahead = max(settings.lead, ages.bearing)
            turned = body.motion.yaw(time) - body.motion.yaw(aim.time) + (ahead - ages.bearing) * body_rate
            pan = float(wrap(track.azimuth + ahead * aim.rate - turned))
            pan = min(max(pan, settings.pan.lower), settings.pan.upper)
            self._pan.follow(self._beyond_dead_band(pan - self._pan.position), seen_rate, dt, slowed)
        if math.isfinite(track.elevation_variance) and math.isfinite(track.elevation):
            self._tilt.follow(self._beyond_dead_band(track.elevation - self._tilt.position), 0.0, dt, slowed)
        else:
            self._tilt.stop(dt)
        if not settings.move_body:
            body.stop(dt)
        elif not settings.move_gimbal or abs(aim.azimuth) > settings.body_follows_at or abs(body.velocity) > 0.0:
            body.turn(time, dt, aim, settings.dead_band, ages.measurement, ages.body_left - settings.period)

    def _hold(self, dt: float, neutral: bool) -> None:
        self.body.stop(dt)
        for axis in (self._pan, self._tilt):
            if neutral:
                axis.follow(-axis.position, 0.0, dt)
            else:
                axis.stop(dt)

    def _beyond_dead_band(self, error: float) -> float:
        return math.copysign(max(abs(error) - self.settings.dead_band, 0.0), error)
