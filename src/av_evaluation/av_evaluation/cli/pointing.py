"""Pointing with a vehicle that answers late: errors, overshoot and stop, beside a controller that knows nothing of delays.

ros2 run av_evaluation pointing [--seconds 20]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.track import Track
from av_evaluation.closed_loop import Conditions, close_loop
from av_pointing.controller import Ages, Command, Look, Mode, PointingController, PointingSettings
from av_pointing.stage import PointingStage

SETTLED_S = 8.0
STOPS_S = (6.0, 6.03)
LAGS_S = (0.2, 0.4, 0.8)
DELAYS_S = (0.1, 0.2, 0.3, 0.5, 0.8)    # of the bearings and the vehicle's dead time together


class FormerController(PointingController):
    """The controller of version 0.2: the error as it is seen, and no notion of what has been commanded but not turned yet."""

    def __init__(self, settings: PointingSettings) -> None:
        super().__init__(settings)
        self._axis = LimitedAxis(AxisLimits(settings.yaw.rate, math.radians(180.0)))
        self._before = math.nan

    def step(self, time: float, track: Track | None, ages: Ages, cue: Look | None = None) -> Command:
        """The command that follows from a track; cues are not obeyed."""
        dt = min(max(time - self._before, 0.0), 0.1) if math.isfinite(self._before) else 0.0
        self._before = time
        if track is None:
            self._axis.stop(dt)
        else:
            rate = track.azimuth_world_rate
            error = float(wrap(track.azimuth + self.settings.lead * (rate - self._axis.velocity)))
            self._axis.follow(math.copysign(max(abs(error) - self.settings.dead_band, 0.0), error), rate, dt)
        self._axis.limit(self._axis.limits.acceleration * max(ages.body_left - self.settings.period, 0.0))
        return Command(Mode.TRACK, 'former', 0.0, 0.0, 0.0, 0.0, self._axis.velocity, False, True)


class Figures(NamedTuple):
    """Results (deg) of one controller.

    Parameters:
        still, moving: RMS of the body's error after SETTLED_S, target at rest, and at 20 deg/s.
        overshoot: beyond the target at rest.
        stop: largest turn from 0.3 s after the arrival of the newest measurement, from 30 deg/s.
    """

    still: float
    moving: float
    overshoot: float
    stop: float


@dataclass(frozen=True)
class Case:
    """A row of the table.

    Parameters:
        delay, lag (s): age of bearings and dead time together, and lag of the vehicle.
    """

    delay: float
    lag: float

    @property
    def conditions(self) -> Conditions:
        """The vehicle's dead time is that of PX4 where the delay leaves room for it."""
        dead_time = min(0.1, self.delay)
        return Conditions(dead_time=dead_time, lag=self.lag, bearing_age=self.delay - dead_time, age_jitter=0.01,
                          noise=math.radians(0.5))


def figures(former: bool, case: Case, seconds: float) -> Figures:
    """The results of a controller.

    Parameters:
        former: the controller that knows nothing of delays, instead of that of this package.
        case: delay and lag.
        seconds (s): duration of a run.
    """
    def stage() -> PointingStage:
        settings = PointingSettings(move_gimbal=False)
        return PointingStage(FormerController(settings) if former else PointingController(settings))

    still = close_loop(stage(), case.conditions, lambda _: math.radians(60.0), seconds)
    moving = close_loop(stage(), case.conditions, lambda t: math.radians(20.0 * t - 60.0), seconds)
    return Figures(still.rms_deg(SETTLED_S), moving.rms_deg(SETTLED_S), still.overshoot_deg(),
                   max(stop_deg(stage(), case.conditions, until) for until in STOPS_S))


def stop_deg(stage: PointingStage, conditions: Conditions, until: float, rate_deg: float = 30.0) -> float:
    """Turn (deg) from 0.3 s after the arrival of the newest measurement, of a body that follows a target.

    Parameters:
        stage: gives the commands.
        conditions: see `Conditions`.
        until (s): measurements arrive before this time.
        rate_deg (deg/s): of the target.
    """
    loop = close_loop(stage, conditions, lambda t: math.radians(rate_deg * t), until + 4.0, measured_until=until)
    return abs(loop.turned_deg(loop.newest + 0.3))


def rows(seconds: float) -> Iterator[str]:
    """The table, line by line."""
    yield '| delay, lag (s) | RMS at rest | RMS at 20 deg/s | overshoot | stop from 30 deg/s |'
    yield '|---|---|---|---|---|'
    for delay in DELAYS_S:
        for lag in LAGS_S:
            case = Case(delay, lag)
            new, old = figures(False, case, seconds), figures(True, case, seconds)
            pairs = ' | '.join(f'{now:.1f} ({before:.1f})' for now, before in zip(new, old, strict=True))
            yield f'| {delay:.1f}, {lag:.1f} | {pairs} |'


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--seconds', type=float, default=16.0, help='duration of a run (default: %(default)s)')
    options = parser.parse_args()
    print('deg, of this controller (of one that knows nothing of delays)\n')
    for line in rows(options.seconds):
        print(line, flush=True)


if __name__ == '__main__':
    main()
