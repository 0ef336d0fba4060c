"""How fast a body that answers late may be driven with an old measurement, so that it still stops as promised."""

from __future__ import annotations

import math
from typing import NamedTuple

COMMAND_LIFETIME_S = 0.3         # a command without a successor moves nothing after this time
OLDEST_MEASUREMENT_S = 1.0       # age since its capture from which a measurement moves no body, and on arrival nothing
LONGEST_DEAD_TIME_S, LONGEST_LAG_S = 0.6, 1.6    # of vehicles that are driven
STOP_WITHIN = 0.3                # s, from the arrival of the newest measurement until the yaw rate is 0
TURNS_ON = math.radians(9.6)     # rad, by which a body turns on after that: less than the 10 deg that are promised
# s, age of a measurement up to which any body is driven: PX4 at 30 deg/s turns on by TURNS_ON then. Faster bodies and slower
# vehicles turn on further, in proportion to rate and lag.
SOONEST = 0.11


class YawAnswer(NamedTuple):
    """Answer of a vehicle to a commanded yaw rate: a dead time, then a first-order lag; by default that of PX4, as flown.

    Parameters:
        dead_time, lag (s): of the answer.
        gain: yaw rate that is reached, relative to the commanded one.
    """

    dead_time: float = 0.1
    lag: float = 0.4
    gain: float = 1.0


def fastest_stoppable(turning: float, left: float, period: float, acceleration: float, answer: YawAnswer) -> float:
    """Yaw rate (rad/s) that may be commanded for one more period, if 0 is commanded after it.

    A body that turns by `turning` when 0 begins to show turns on by lag * turning * exp(-(left - dead_time) / lag) after
    STOP_WITHIN. Bringing a rate to 0 takes rate / acceleration, in which the body turns on by half of that rate.

    Parameters:
        turning (rad/s): magnitude of the yaw rate a dead time from now, by what was commanded.
        left (s): time from the end of the period to STOP_WITHIN after the newest measurement.
        period (s): until the next decision, more than 0.
        acceleration (rad/s^2): largest change of the commanded rate.
        answer: of the vehicle.
    """
    dead_time, lag, gain = answer
    most = max(TURNS_ON / lag * math.exp((left - dead_time) / lag), turning * math.exp((left - STOP_WITHIN + SOONEST) / lag))
    kept, braking = math.exp(-period / lag), 2.0 * acceleration * lag * gain
    share, spare = (1.0 - kept) * braking, most - kept * turning
    return 0.5 * (math.sqrt(share**2 + 4.0 * braking * spare) - share) / gain if spare > 0.0 else 0.0
