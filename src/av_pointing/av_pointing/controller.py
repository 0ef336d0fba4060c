"""Commands for gimbal and body from a track, within limits of angle, rate and acceleration.

The body moves by measurements only. It stands still BODY_TIMEOUT_S after the newest measurement of the track, or the newest
odometry, arrived; braking begins so early that the last command before that time is 0. The gimbal may follow a prediction for
a while, the slower the older it is.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.track import State, Track

BODY_TIMEOUT_S = 0.3  # after the arrival of the newest measurement, and of the newest odometry, at which the body stands still
LONGEST_STEP_S = 0.1  # longer steps are computed as this long
YAW_MEMORY_S, LONGEST_YAW_GAP_S = 0.1, 0.5  # time span and longest gap of the bearings that give the body's yaw rate


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
    """

    bearing: float = math.inf
    measurement: float = math.inf
    odometry: float = math.inf

    @property
    def body_left(self) -> float:
        """Time (s) until the body must stand still."""
        return BODY_TIMEOUT_S - max(self.measurement, self.odometry)


@dataclass(frozen=True)
class PointingSettings:
    """Settings of `PointingController`.

    Parameters:
        pan, tilt, yaw: limits of the gimbal's axes and of the body's yaw.
        search_rate (rad/s): rate of the body's rotation that resolves the front-back ambiguity.
        dead_band (rad): error below which nothing moves.
        lead (s): delay between command and motion, compensated by the bearing's rate.
        period (s): longest time between two commands.
        stale_after (s): age from which a bearing is stale and moves nothing.
        coast (s): time after the newest measurement's arrival for which the gimbal follows a prediction.
        coast_sigma (rad): standard deviation of a prediction's azimuth up to which the gimbal follows it.
        on_stale: reaction of the gimbal to a stale bearing: 'hold' stops it, 'neutral' returns it to 0.
        move_gimbal, move_body: whether gimbal and body are commanded.
        body_follows_at (rad): pan from which the body follows a moving gimbal.

    Raises ValueError for another `on_stale`.
    """

    pan: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(120), math.radians(360), -2.6, 2.6))
    tilt: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(60), math.radians(180), -1.4, 0.8))
    yaw: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(45), math.radians(180)))
    search_rate: float = math.radians(40.0)
    dead_band: float = math.radians(0.5)
    lead: float = 0.05
    period: float = 1.0 / 30.0
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
        self._yaw = LimitedAxis(self.settings.yaw)
        self._time: float | None = None
        self._yaws: deque[tuple[float, float]] = deque()  # time in s and yaw in rad of the body

    def start_at(self, pan: float, tilt: float) -> None:
        """Stand still at angles of the gimbal (rad), such as those of the controller before, within the limits."""
        for axis, angle in ((self._pan, pan), (self._tilt, tilt)):
            axis.position, axis.velocity = min(max(angle, axis.limits.lower), axis.limits.upper), 0.0

    def step(self, time: float, track: Track | None, ages: Ages) -> Command:
        """The command from the newest track. Steps back in time count as 0, steps of more than 0.1 s as 0.1 s.

        Parameters:
            time (s): time of the command, monotonic.
            track: the newest track; None before the first.
            ages: of what the track rests on, at that time.
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), LONGEST_STEP_S)
        self._time = time
        mode, reason = self._decide(track, ages)
        if track is None or mode == Mode.HOLD:
            self._hold(dt, neutral=self.settings.on_stale == 'neutral' and reason.startswith('no fresh'))
        elif mode == Mode.SEARCH:
            self._yaw.follow(track.requested_rotation, 0.0, dt, self.settings.search_rate)
            self._pan.stop(dt)
            self._tilt.stop(dt)
        else:
            self._track(dt, track, ages)
        self._yaw.limit(self.settings.yaw.acceleration * max(ages.body_left - self.settings.period, 0.0))
        return Command(mode, reason, self._pan.position, self._tilt.position, self._pan.velocity, self._tilt.velocity,
                       self._yaw.velocity, self.enabled and self.settings.move_gimbal,
                       self.enabled and self.settings.move_body)

    def _decide(self, track: Track | None, ages: Ages) -> tuple[Mode, str]:
        settings = self.settings
        if not self.enabled:
            return Mode.HOLD, 'disabled'
        if track is None or not ages.bearing <= settings.stale_after:
            return Mode.HOLD, 'no fresh bearing'
        if track.state == State.NONE or not (math.isfinite(track.azimuth) and math.isfinite(track.azimuth_world_rate)):
            return Mode.HOLD, 'no fresh bearing: no target'
        predicted = ages.measurement >= BODY_TIMEOUT_S
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

    def _track(self, dt: float, track: Track, ages: Ages) -> None:
        settings = self.settings
        left = settings.coast - ages.measurement  # of the gimbal's motion, which slows down until then
        slowed = min(left / settings.coast * settings.pan.rate, left * settings.pan.acceleration)
        rate = track.azimuth_world_rate
        ahead = float(wrap(track.azimuth + settings.lead * (rate - self._yaw.velocity)))
        if settings.move_gimbal:
            seen_rate = rate - self._body_rate(track)
            pan = float(wrap(track.azimuth + settings.lead * seen_rate))
            pan = min(max(pan, settings.pan.lower), settings.pan.upper)
            self._pan.follow(self._beyond_dead_band(pan - self._pan.position), seen_rate, dt, slowed)
        if math.isfinite(track.elevation_variance) and math.isfinite(track.elevation):
            self._tilt.follow(self._beyond_dead_band(track.elevation - self._tilt.position), 0.0, dt, slowed)
        else:
            self._tilt.stop(dt)
        if not settings.move_body:
            self._yaw.stop(dt)
        elif not settings.move_gimbal or abs(ahead) > settings.body_follows_at or abs(self._yaw.velocity) > 0.0:
            self._yaw.follow(self._beyond_dead_band(ahead), rate, dt)

    def _body_rate(self, track: Track) -> float:
        """Yaw rate of the body (rad/s) from recent bearings, because a vehicle may not follow the command."""
        yaw = track.azimuth_world - track.azimuth
        if not math.isfinite(yaw):
            return self._yaw.velocity
        if self._yaws and not 0.0 <= track.time - self._yaws[-1][0] < LONGEST_YAW_GAP_S:
            self._yaws.clear()
        self._yaws.append((track.time, yaw))
        while len(self._yaws) > 2 and self._yaws[1][0] <= track.time - YAW_MEMORY_S:
            self._yaws.popleft()
        elapsed = track.time - self._yaws[0][0]
        return float(wrap(yaw - self._yaws[0][1])) / elapsed if elapsed > 0.02 else self._yaw.velocity

    def _hold(self, dt: float, neutral: bool) -> None:
        self._yaw.stop(dt)
        for axis in (self._pan, self._tilt):
            if neutral:
                axis.follow(-axis.position, 0.0, dt)
            else:
                axis.stop(dt)

    def _beyond_dead_band(self, error: float) -> float:
        return math.copysign(max(abs(error) - self.settings.dead_band, 0.0), error)
