"""Where a gimbal is that reports nothing: a model of its answer to the commands."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from av_common.gimbal_history import RESTART_S
from av_common.rig import GimbalMount

SIGMA = math.radians(1.5)  # of a gimbal at rest where it was commanded to
UNKNOWN_SIGMA = math.radians(10.0)  # of one that no command has reached yet
LAGGING = 0.3  # share of the way that is left to go which the model may be wrong by
MOST_COMMANDS = 100  # that wait for their time


class GimbalAngles(NamedTuple):
    """Angles of a gimbal about its mount's axes.

    Parameters:
        pan, tilt (rad): counter-clockwise and up.
        variance (rad^2): of the error about each axis.
    """

    pan: float
    tilt: float
    variance: float


class GimbalModel:
    """Follows commands with the lag, at most at the rate and within the limits of a gimbal. Times are in s.

    Parameters:
        gimbal: its description.
    """

    def __init__(self, gimbal: GimbalMount) -> None:
        self._lag, self._rate = gimbal.lag, math.radians(gimbal.max_rate_deg)
        self._limits = [tuple(map(math.radians, limits)) for limits in (gimbal.pan_limits_deg, gimbal.tilt_limits_deg)]
        self._angles, self._targets = [0.0, 0.0], [0.0, 0.0]
        self._sigma, self._time = UNKNOWN_SIGMA, -math.inf
        self._commands: deque[tuple[float, float, float]] = deque(maxlen=MOST_COMMANDS)

    def command(self, time: float, pan: float, tilt: float) -> None:
        """Note a command. The first one tells where the gimbal is: commands follow each other without jumps.

        Parameters:
            time (s): when the gimbal receives it.
            pan, tilt (rad): the angles about the mount's axes.
        """
        if not (math.isfinite(pan) and math.isfinite(tilt)):
            raise ValueError(f'a command to pan {pan} and tilt {tilt} rad, expected finite angles')
        self._commands.append((time, pan, tilt))

    def correct(self, time: float, pan: float, tilt: float) -> None:
        """Continue from measured angles.

        Parameters:
            time (s): when they were measured.
            pan, tilt (rad): about the mount's axes.
        """
        if self._sigma == UNKNOWN_SIGMA:
            self._targets = [pan, tilt]
        self._begin_due(time)
        self._angles, self._sigma, self._time = [pan, tilt], SIGMA, time

    def at(self, time: float) -> GimbalAngles:
        """The angles at a time (s), which should not decrease."""
        if time < self._time - RESTART_S:
            self._time = -math.inf
            self._commands.clear()
        self._begin_due(time)
        self._advance(time)
        left = math.hypot(*(target - angle for target, angle in zip(self._targets, self._angles, strict=True)))
        pan, tilt = self._angles
        return GimbalAngles(pan, tilt, self._sigma**2 + (LAGGING * left) ** 2)

    def _begin_due(self, time: float) -> None:
        """Take the commands up to a time."""
        while self._commands and self._commands[0][0] <= time:
            begin, *targets = self._commands.popleft()
            self._advance(begin)
            self._targets = [min(max(target, low), high)
                             for target, (low, high) in zip(targets, self._limits, strict=True)]
            if self._sigma == UNKNOWN_SIGMA:
                self._angles, self._sigma = list(self._targets), SIGMA

    def _advance(self, time: float) -> None:
        dt = max(time - self._time, 0.0) if math.isfinite(self._time) else 0.0
        self._time = max(self._time, time)
        share = 1.0 - math.exp(-dt / self._lag) if self._lag > 0.0 else 1.0
        most = self._rate * dt
        self._angles = [angle + min(max(share * (target - angle), -most), most)
                        for angle, target in zip(self._angles, self._targets, strict=True)]
