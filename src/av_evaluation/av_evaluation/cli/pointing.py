"""`ros2 run av_evaluation pointing`: errors, overshoot and stop of pointing with a simulated vehicle that answers late."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

from av_evaluation.closed_loop import Conditions, close_loop
from av_pointing.controller import PointingController, PointingSettings
from av_pointing.stage import PointingStage

SETTLED_S = 8.0
STOPS_S = (6.0, 6.03)    # times of the newest measurement, of which the worse counts
LAGS_S = (0.2, 0.4, 0.8)
DELAYS_S = (0.1, 0.2, 0.3, 0.5, 0.8)    # of the bearings and the vehicle's dead time together
DEAD_TIME_S = 0.1    # of PX4, where the delay leaves room for it


def figures(delay: float, lag: float, seconds: float) -> tuple[float, float, float, float]:
    """RMS of the error of the body with a target at rest and at 20 deg/s, overshoot, and turn after a stop; all in deg.

    The stop is the turn from 0.3 s after the arrival of the newest measurement of a target at 30 deg/s.

    Parameters:
        delay, lag (s): age of bearings and dead time together, and lag of the vehicle.
        seconds (s): duration of a run.
    """
    dead_time = min(DEAD_TIME_S, delay)
    conditions = Conditions(dead_time=dead_time, lag=lag, bearing_age=delay - dead_time, age_jitter=0.01,
                            noise=math.radians(0.5))

    def stage() -> PointingStage:
        return PointingStage(PointingController(PointingSettings(move_gimbal=False)))

    def stop(until: float) -> float:
        loop = close_loop(stage(), conditions, lambda t: math.radians(30.0 * t), until + 4.0, measured_until=until)
        return abs(loop.turned_deg(loop.newest + 0.3))

    still = close_loop(stage(), conditions, lambda _: math.radians(60.0), seconds)
    moving = close_loop(stage(), conditions, lambda t: math.radians(20.0 * t - 60.0), seconds)
    return still.rms_deg(SETTLED_S), moving.rms_deg(SETTLED_S), still.overshoot_deg(), max(map(stop, STOPS_S))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(prog='pointing', description=__doc__)
    parser.add_argument('--seconds', type=float, default=16.0, help='duration of a run (default: %(default)s)')
    options = parser.parse_args(arguments)
    print('| delay, lag (s) | RMS at rest (deg) | RMS at 20 deg/s | overshoot | stop from 30 deg/s |\n|---|---|---|---|---|')
    for delay in DELAYS_S:
        for lag in LAGS_S:
            cells = ' | '.join(f'{value:.1f}' for value in figures(delay, lag, options.seconds))
            print(f'| {delay:.1f}, {lag:.1f} | {cells} |', flush=True)
    return 0
