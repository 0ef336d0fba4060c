"""Commands for gimbal and body from a track, within limits of angle, rate and acceleration.

The body moves by measurements only. Its yaw rate is 0 STOP_WITHIN after the newest measurement of the track, or the newest
odometry, arrived, and what a fast body still turns is braked before (`body_axis.py`). The gimbal may follow a prediction for a
while, the slower the older it is.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from std_msgs.msg import Header

from av_common.angles import wrap
from av_common.frames import BASE_FRAME, yaw_of
from av_common.gimbal_geometry import BASE_STABILIZED, LEVEL
from av_common.stopping import OLDEST_MEASUREMENT_S, STOP_WITHIN
from av_common.track import State, Track
from av_interfaces.msg import PointingCommand
from av_pointing.body_axis import DEAD_BAND, Aim, BodyAxis
from av_pointing.gimbal_axes import GimbalAxes
from av_pointing.settings import PointingSettings

LONGEST_STEP_S = 0.1  # longer steps are computed as this long
PERIOD_S = 1.0 / 30.0  # longest time between two commands, by which braking begins earlier
STALE_AFTER_S = 0.3  # after its arrival, from which a bearing moves nothing: six periods of fusion's slowest output
COAST_SIGMA = math.radians(20.0)  # of a prediction's azimuth, up to which the gimbal follows it: half a camera's view
LEAD_S = 0.05  # after its stamp for which a bearing is given to the gimbal, or its age where that is larger: lag of a gimbal
SEARCH_RATE = math.radians(40.0)  # rad/s, of the rotation that resolves front and back, at most that of the body


class Mode(enum.IntEnum):
    """Mode of a command; the values of `av_interfaces/PointingCommand`."""

    HOLD = 0
    TRACK = 1
    SEARCH = 2
    LOOK = 3


class Look(NamedTuple):
    """A direction in which others say that a target is.

    Parameters:
        azimuth, elevation (rad): in the world, or level and from the body's heading.
        in_body: whether the azimuth is from the body's heading.
    """

    azimuth: float
    elevation: float
    in_body: bool = False


class Ages(NamedTuple):
    """Ages (s) of what a command rests on, at the time of the command; inf for what never arrived.

    Parameters:
        bearing: time since the bearing arrived, and distance of its stamp from that.
        measurement: time since the newest measurement of the bearing arrived.
        odometry: time since the newest odometry arrived.
        late: part of `bearing` that had passed on its arrival.
        captured: time since the newest measurement was captured.
        cue, cue_captured: time since the newest cue arrived, and since its stamp.
        supported: whether the bearing rests on a measurement that counts; else nothing follows it, and what turns is braked.
    """

    bearing: float = math.inf
    measurement: float = math.inf
    odometry: float = math.inf
    late: float = 0.0
    captured: float = 0.0
    cue: float = math.inf
    cue_captured: float = math.inf
    supported: bool = True

    @property
    def body_left(self) -> float:
        """Time (s) until the body must stand still."""
        return min(STOP_WITHIN - max(self.measurement, self.odometry), OLDEST_MEASUREMENT_S - self.captured)

    @property
    def attitude_known(self) -> bool:
        """Whether odometry tells the body's attitude; else the rig counts as level, as in fusion."""
        return self.odometry <= OLDEST_MEASUREMENT_S

    @property
    def predicted(self) -> bool:
        """Whether the bearing is a prediction, without a recent measurement."""
        return self.measurement >= STOP_WITHIN or self.captured >= OLDEST_MEASUREMENT_S


class PointingController:
    """Computes commands from tracks; `step` is called at least every PERIOD_S.

    Attributes:
        settings: see `PointingSettings`.
        enabled: whether commands move anything.
        gimbal: its axes.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: PointingSettings | None = None) -> None:
        self.settings = settings or PointingSettings()
        self.enabled = True
        self.gimbal = GimbalAxes(self.settings.gimbal, self.settings.pan, self.settings.tilt, DEAD_BAND)
        self.body = BodyAxis(self.settings.yaw, self.settings.response)
        self._time: float | None = None
        self._seen: Track | None = None
        self._vehicle_rate, self._has_odometry = math.inf, False

    def limit_body(self, rate: float) -> None:
        """Note the largest yaw rate (rad/s) that the vehicle is given, of which the prediction must know, too; inf for none.

        Raises ValueError for a rate that is not positive.
        """
        if not rate > 0.0:
            raise ValueError(f'a limit of {rate} rad/s, expected a positive one')
        self._vehicle_rate = rate
        self.body.limit_rate(min(rate, self.settings.yaw.rate))

    def set_yaw_rate(self, rate: float) -> None:
        """Use another largest yaw rate (rad/s) from the next command on, or the vehicle's where that is smaller."""
        self.settings = replace(self.settings, yaw=replace(self.settings.yaw, rate=rate))
        self.body.limit_rate(min(self._vehicle_rate, rate))

    @property
    def may_move(self) -> str:
        """What commands move once they are enabled, in words."""
        settings = self.settings
        parts = [('the gimbal', settings.move_gimbal, settings.pan.rate),
                 ('the body of the rig', settings.move_body, self.body.limits.rate)]
        return ' and '.join(f'{part} (up to {math.degrees(rate):.0f} deg/s)' for part, on, rate in parts if on) or 'nothing'

    def on_attitude(self, time: float, attitude_wxyz: Sequence[float]) -> None:
        """Note the body's attitude (w, x, y, z) in the world by odometry of `time` (s, on the clock of `step`)."""
        self._has_odometry = True
        self.body.motion.measure(time, yaw_of(attitude_wxyz))
        self.gimbal.attitude_wxyz = attitude_wxyz

    def step(self, time: float, track: Track | None, ages: Ages, cue: Look | None = None) -> PointingCommand:
        """The command from the newest track, without a stamp. Steps back in time count as 0, steps of more than 0.1 s as 0.1 s.

        Parameters:
            time (s): time of the command, monotonic.
            track: the newest track; None before the first.
            ages: of what the track rests on, at that time.
            cue: the newest cue, to which the gimbal turns while it is as fresh as a bearing must be, and there is no fresh
                bearing; the body never does.
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), LONGEST_STEP_S)
        self._time = time
        self.body.motion.advance(time)
        if not ages.attitude_known:
            self.gimbal.attitude_wxyz = LEVEL
        settings, left = self.settings, ages.body_left - PERIOD_S
        stale = self._stale(track, ages) if self.enabled else ''
        mode, reason = self._decide(track, ages, stale)
        if track is not None and track is not self._seen:
            self._see(time, track, ages)
        if cue is not None and stale and self._may_look(cue, ages):
            mode, reason = Mode.LOOK, self._look(time, dt, cue)
        elif track is None or mode == Mode.HOLD:
            self.body.stop(dt)
            returns = settings.neutral and stale != ''
            self.gimbal.hold(dt, neutral=returns)
            if returns and settings.move_gimbal:    # to hold is to move nothing
                mode, reason = Mode.LOOK, f'{stale}; the gimbal returns to 0'
        elif mode == Mode.SEARCH:
            aim = self._aim(time, track, ages)._replace(azimuth=track.requested_rotation, rate=0.0)
            self.body.turn(time, dt, aim, left, SEARCH_RATE)
            self.gimbal.follow(dt, None, None)
        elif mode == Mode.LOOK and (look := _look_of(track)) is not None:
            self.body.stop(dt)
            self.gimbal.follow(dt, *self.gimbal.of_body(*look), self._slowed(ages))
        else:
            self._track(time, dt, track, ages)
        yaw_rate = self.body.command(time, left, self.enabled and settings.move_body)
        pan, tilt, pan_rate, tilt_rate = self.gimbal.command
        return PointingCommand(
            header=Header(frame_id=BASE_STABILIZED if settings.gimbal.stabilized else BASE_FRAME), mode=int(mode),
            reason=reason, move_gimbal=self.enabled and settings.move_gimbal, pan=pan, tilt=tilt, pan_rate=pan_rate,
            tilt_rate=tilt_rate, move_body=self.enabled and settings.move_body, yaw_rate=yaw_rate)

    def _stale(self, track: Track | None, ages: Ages) -> str:
        """Why there is no fresh bearing; empty where there is one."""
        if track is None or not ages.bearing - ages.late <= STALE_AFTER_S or not ages.late <= OLDEST_MEASUREMENT_S:
            return 'no fresh bearing'
        if track.state == State.NONE or not (math.isfinite(track.azimuth) and math.isfinite(track.azimuth_world_rate)):
            return 'no fresh bearing: no target'
        uncertain = ages.predicted and not 0.0 <= track.azimuth_variance <= COAST_SIGMA**2
        if ages.measurement >= self.settings.coast or uncertain or not ages.supported:
            return 'no fresh bearing: a prediction without recent measurements'
        return ''

    def _decide(self, track: Track | None, ages: Ages, stale: str) -> tuple[Mode, str]:
        if not self.enabled:
            return Mode.HOLD, 'disabled'
        if stale or track is None:
            return Mode.HOLD, stale
        settings, predicted = self.settings, ages.predicted
        may_move = ages.body_left > 0.0
        stands = f'the body stands still without recent {"measurements" if predicted else "odometry"}'
        if track.resolved or track.state == State.VISUAL_ACTIVE:
            if may_move or not settings.move_body:
                return Mode.TRACK, 'following a prediction' if predicted else 'following the bearing'
            if settings.move_gimbal:
                return Mode.TRACK, f'the gimbal follows {"a prediction" if predicted else "the bearing"}, {stands}'
            return Mode.HOLD, stands
        return self._decide_ambiguous(track, may_move, stands)

    def _decide_ambiguous(self, track: Track, may_move: bool, stands: str) -> tuple[Mode, str]:
        """A look of the gimbal goes before a turn of the body."""
        settings = self.settings
        look = _look_of(track)
        if look is not None and settings.move_gimbal:
            azimuth, elevation = map(math.degrees, look)
            return Mode.LOOK, f'looking at azimuth {azimuth:+.0f} deg, elevation {elevation:+.0f} deg for the target'
        if math.isfinite(track.requested_rotation) and track.requested_rotation != 0.0 and settings.move_body:
            if not may_move:
                return Mode.HOLD, stands
            return Mode.SEARCH, f'turning {math.degrees(track.requested_rotation):+.0f} deg to resolve the front-back ambiguity'
        return Mode.HOLD, 'waiting: the front-back ambiguity is open'

    def _may_look(self, cue: Look, ages: Ages) -> bool:
        """Whether the gimbal may turn to a cue: fresh, and in the world only while a heading that was given is known."""
        fresh = ages.cue <= STALE_AFTER_S and ages.cue_captured <= OLDEST_MEASUREMENT_S
        known = cue.in_body or not self._has_odometry or ages.odometry <= STALE_AFTER_S
        return self.settings.move_gimbal and fresh and known

    def _look(self, time: float, dt: float, cue: Look) -> str:
        """Turn the gimbal to a cue; returns the reason."""
        self.body.stop(dt)
        heading = 0.0 if cue.in_body or not self._has_odometry else self.body.motion.yaw(time)
        azimuth = float(wrap(cue.azimuth - heading))
        self.gimbal.follow(dt, *self.gimbal.of_level(azimuth, cue.elevation))
        return (f'looking at a cue at azimuth {math.degrees(azimuth):+.0f} deg, '
                f'elevation {math.degrees(cue.elevation):+.0f} deg')

    def _see(self, time: float, track: Track, ages: Ages) -> None:
        """Note how a new track moves, and without odometry how the body turns."""
        self._seen = track
        if track.state == State.NONE or not math.isfinite(ages.bearing + track.azimuth + track.azimuth_world_rate):
            return
        if not self._has_odometry:
            self.body.motion.measure(time - ages.bearing, track.azimuth_world - track.azimuth)
        self.body.see(self._aim(time, track, ages))

    def _aim(self, time: float, track: Track, ages: Ages) -> Aim:
        """The direction of a track, by its direction in the world where the attitude is known."""
        seen = time - ages.bearing
        known = track.attitude_known and ages.attitude_known and math.isfinite(track.azimuth_world)
        azimuth = float(wrap(track.azimuth_world - self.body.motion.yaw(seen))) if known else track.azimuth
        return Aim(azimuth, track.azimuth_world_rate, seen)

    def _track(self, time: float, dt: float, track: Track, ages: Ages) -> None:
        settings, body, aim = self.settings, self.body, self._aim(time, track, ages)
        look = _look_of(track)
        if settings.move_gimbal and look is not None:
            self.gimbal.follow(dt, *self.gimbal.of_body(*look), self._slowed(ages))
        elif settings.move_gimbal:
            body_rate, ahead = body.motion.rate(time), max(LEAD_S, ages.bearing)
            turned = body.motion.yaw(time) - body.motion.yaw(aim.time) + (ahead - ages.bearing) * body_rate
            elevation = self._elevation(track, ages, ahead)
            pan, tilt = self.gimbal.of_level(aim.azimuth + ahead * aim.rate - turned, elevation or 0.0)
            self.gimbal.follow(dt, pan, None if elevation is None else tilt, self._slowed(ages), aim.rate - body_rate)
        if not settings.move_body:
            body.stop(dt)
        elif not settings.move_gimbal or abs(aim.azimuth) > settings.body_follows_at or abs(body.velocity) > 0.0:
            body.turn(time, dt, aim, ages.body_left - PERIOD_S)

    @staticmethod
    def _elevation(track: Track, ages: Ages, ahead: float) -> float | None:
        """Elevation (rad) in the world of a track `ahead` s later, None while it has none."""
        if math.isfinite(track.elevation_variance) and math.isfinite(track.elevation):
            known = (track.attitude_known and ages.attitude_known
                     and math.isfinite(track.elevation_world + track.elevation_world_rate))
            return track.elevation_world + ahead * track.elevation_world_rate if known else track.elevation
        return None

    def _slowed(self, ages: Ages) -> float:
        """Rate (rad/s) of the gimbal, which slows down as the newest measurement ages."""
        left = self.settings.coast - ages.measurement
        return max(min(left / self.settings.coast * self.settings.pan.rate, left * self.settings.pan.acceleration), 0.0)


def _look_of(track: Track) -> tuple[float, float] | None:
    """The look that a track asks for, None without a possible one."""
    return track.look if track.look is not None and all(map(math.isfinite, track.look)) else None
