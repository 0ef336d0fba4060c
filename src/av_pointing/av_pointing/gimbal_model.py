"""Where a gimbal is that reports nothing: a model of its answer to the commands."""

from __future__ import annotations

import math

from av_common.gimbal_history import RESTART_S
from av_common.rig import GimbalMount

SIGMA = math.radians(1.5)  # of a gimbal at rest where it was commanded to
UNKNOWN_SIGMA = math.radians(10.0)  # of one that no command has reached yet
LAGGING = 0.3  # share of the way that is left to go which the model may be wrong by


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

    def command(self, time: float, pan: float, tilt: float) -> None:
        """Note a command. The first one tells where the gimbal is: commands follow each other without jumps.

        Parameters:
            time (s): when the gimbal receives it.
            pan, tilt (rad): the angles about the mount's axes.
        """
        self._advance(time)
        self._targets = [min(max(target, low), high)
                         for target, (low, high) in zip((pan, tilt), self._limits, strict=True)]
        if self._sigma == UNKNOWN_SIGMA:
            self._angles, self._sigma = list(self._targets), SIGMA

    def correct(self, time: float, pan: float, tilt: float) -> None:
        """Continue from measured angles.

        Parameters:
            time (s): when they were measured.
            pan, tilt (rad): about the mount's axes.
        """
        if self._sigma == UNKNOWN_SIGMA:
            self._targets = [pan, tilt]
        self._angles, self._sigma, self._time = [pan, tilt], SIGMA, time

    def at(self, time: float) -> tuple[float, float, float]:
        """Pan and tilt (rad) at a time (s), which should not decrease, and the variance (rad^2) of each."""
        self._advance(time)
        left = math.hypot(*(target - angle for target, angle in zip(self._targets, self._angles, strict=True)))
        pan, tilt = self._angles
        return pan, tilt, self._sigma**2 + (LAGGING * left) ** 2

    def _advance(self, time: float) -> None:
        if time < self._time - RESTART_S:  # the clock was set back
            self._time = time
        dt = max(time - self._time, 0.0) if math.isfinite(self._time) else 0.0
        self._time = max(self._time, time)
        share = 1.0 - math.exp(-dt / self._lag) if self._lag > 0.0 else 1.0
        most = self._rate * dt
        self._angles = [angle + min(max(share * (target - angle), -most), most)
                        for angle, target in zip(self._angles, self._targets, strict=True)]
