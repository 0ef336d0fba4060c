"""Does the heading that odometry reports turn while the rig turns, by its own rates or by the commands?"""

from __future__ import annotations

import math
from collections import deque

from av_common.angles import wrap
from av_common.stopping import COMMAND_LIFETIME_S, LONGEST_DEAD_TIME_S, LONGEST_LAG_S
from av_fusion.consistency.events import Fault
from av_fusion.measurement.rig_motion import FROZEN_RAD, RigMotion

UNKNOWN = math.pi**2 / 3.0  # rad^2, of a heading that may be any
SAME = 1e-9  # rad, by which rounding changes a heading: a measured one changes by more from message to message
ANSWER_S = LONGEST_DEAD_TIME_S + LONGEST_LAG_S  # in which any vehicle has answered
HELD = 0.5  # probability that the vehicle is held rather than its heading frozen: no measurement separates these


class HeadingWatch:
    """Compares the heading with the turns that are commanded, and with the rates that come with it.

    That the heading is the same to the last digit while commands turn the rig has two causes: the vehicle does not turn, or
    the heading is frozen. Both have the same probability, and bearings in the world may be off by the commanded turn.

    Attributes:
        in_world (rad^2): mean square by which a heading is off.

    Parameters:
        motion: attitude of the rig.
    """

    def __init__(self, motion: RigMotion) -> None:
        self.in_world = 0.0
        self._motion, self._heading, self._largest = motion, math.nan, 0.0
        self._turns: deque[tuple[float, float]] = deque([(-math.inf, 0.0)])  # time, commanded turn (rad) since the change
        self._commanded, self._rate = -math.inf, 0.0

    def command(self, time: float, yaw_rate: float) -> None:
        """Note that the body is told to turn by a rate (rad/s) from `time` (s) on."""
        lasted = min(max(time - self._commanded, 0.0), COMMAND_LIFETIME_S)
        self._turns.append((time, self._turns[-1][1] + self._rate * lasted))
        self._commanded, self._rate = time, yaw_rate

    def check(self, now: float) -> Fault | None:
        """What is wrong with the heading at `now` (s)."""
        heading = self._motion.yaw(self._motion.newest)
        known, changed = self._motion.is_known(now), not abs(wrap(heading - self._heading)) <= SAME
        if changed or not known or self._turns[-1][0] > now:  # the last after a clock was set
            self._turns = deque([(-math.inf, 0.0)])
            self._heading, self._largest = heading, 0.0
        while len(self._turns) > 1 and self._turns[1][0] <= now - ANSWER_S:
            self._turns.popleft()
        self._largest = max(self._largest, abs(self._turns[0][1]))
        self.in_world = 0.0
        if not known and math.isfinite(self._motion.newest):
            self.in_world = UNKNOWN
        if self._motion.is_frozen:
            return Fault('the heading is not known: the attitude of the odometry does not follow its own rates',
                         'the estimator that publishes odometry', 1.0, False)
        if self._largest <= FROZEN_RAD:
            return None
        self.in_world = (1.0 - HELD) * min(max(turn**2 for _, turn in (*self._turns, (now, self._largest))), UNKNOWN)
        return Fault(f'the heading of the odometry is frozen, or the vehicle is held: commands of '
                     f'{math.degrees(self._largest):.0f} deg changed it by nothing',
                     'the estimator that publishes odometry, or what moves the vehicle', 1.0 - HELD, False)
