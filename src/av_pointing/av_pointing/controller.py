"""Commands for gimbal and body from a track, within limits of angle, rate and acceleration."""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.track import State, Track

LONGEST_STEP_S = 0.1  # longer steps are computed as this long
YAW_MEMORY_S, LONGEST_YAW_GAP_S = 0.1, 0.5  # time span and longest gap of the bearings that give the body's yaw rate


class Mode(enum.IntEnum):
    """Mode of a command; the values of `av_interfaces/PointingCommand`."""

    HOLD = 0
    TRACK = 1
    SEARCH = 2


@dataclass(frozen=True)
class PointingSettings:
    """Settings of `PointingController`.

    Parameters:
        pan, tilt, yaw: limits of the gimbal's axes and of the body's yaw.
        search_rate (rad/s): rate of the body's rotation that resolves the front-back ambiguity.
        dead_band (rad): error below which nothing moves.
        lead (s): delay between command and motion, compensated by the bearing's rate.
        stale_after (s): age from which a bearing is stale and moves nothing.
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
    stale_after: float = 0.5
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
    """Computes commands from tracks; `step` is called at a steady rate.

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

    def step(self, time: float, track: Track | None) -> Command:
        """The command from the newest track. Steps back in time count as 0, steps of more than 0.1 s as 0.1 s.

        Parameters:
            time (s): time of the command.
            track: the newest track; None before the first.
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), LONGEST_STEP_S)
        self._time = time
        mode, reason = self._decide(time, track)
        if track is None or mode == Mode.HOLD:
            self._hold(dt, neutral=self.settings.on_stale == 'neutral' and reason.startswith('no fresh'))
        elif mode == Mode.SEARCH:
            self._yaw.follow(track.requested_rotation, 0.0, dt, self.settings.search_rate)
            self._pan.stop(dt)
            self._tilt.stop(dt)
        else:
            self._track(dt, track)
        return Command(mode, reason, self._pan.position, self._tilt.position, self._pan.velocity, self._tilt.velocity,
                       self._yaw.velocity, self.enabled and self.settings.move_gimbal,
                       self.enabled and self.settings.move_body)

    def _decide(self, time: float, track: Track | None) -> tuple[Mode, str]:
        if not self.enabled:
            return Mode.HOLD, 'disabled'
        if track is None or not abs(time - track.time) <= self.settings.stale_after:
            return Mode.HOLD, 'no fresh bearing'
        if track.state == State.NONE or not (math.isfinite(track.azimuth) and math.isfinite(track.azimuth_world_rate)):
            return Mode.HOLD, 'no fresh bearing: no target'
        if track.resolved or track.state == State.VISUAL_ACTIVE:
            return Mode.TRACK, 'following the bearing'
        if math.isfinite(track.requested_rotation) and track.requested_rotation != 0.0 and self.settings.move_body:
            return Mode.SEARCH, f'turning {math.degrees(track.requested_rotation):+.0f} deg to resolve the front-back ambiguity'
        return Mode.HOLD, 'waiting: the front-back ambiguity is open'

    def _track(self, dt: float, track: Track) -> None:
        settings = self.settings
        rate = track.azimuth_world_rate
        ahead = float(wrap(track.azimuth + settings.lead * (rate - self._yaw.velocity)))
        if settings.move_gimbal:
            seen_rate = rate - self._body_rate(track)
            pan = float(wrap(track.azimuth + settings.lead * seen_rate))
            pan = min(max(pan, settings.pan.lower), settings.pan.upper)
            self._pan.follow(self._beyond_dead_band(pan - self._pan.position), seen_rate, dt)
        if math.isfinite(track.elevation_variance) and math.isfinite(track.elevation):
            self._tilt.follow(self._beyond_dead_band(track.elevation - self._tilt.position), 0.0, dt)
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
