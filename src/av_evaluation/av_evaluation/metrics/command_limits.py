"""Checks that pointing commands are finite and within the limits of angle, rate and acceleration."""

from __future__ import annotations

import math
from typing import Protocol

from av_pointing.controller import PointingSettings


class AxisCommand(Protocol):
    """A pointing command, as plain data or as message: angles in rad, rates in rad/s."""

    @property
    def pan(self) -> float:
        """Angle of the gimbal about the vertical axis."""

    @property
    def tilt(self) -> float:
        """Elevation of the gimbal."""

    @property
    def pan_rate(self) -> float:
        """Rate of `pan`."""

    @property
    def tilt_rate(self) -> float:
        """Rate of `tilt`."""

    @property
    def yaw_rate(self) -> float:
        """Yaw rate of the body."""


class CommandLimits:
    """Compares each command with the limits and with the command before.

    Parameters:
        settings: limits of the axes.
        tolerance (rad, rad/s): excess that is permitted for rounding.
        jitter (s): by which a command's time may be wrong; over many commands that adds nothing to the acceleration.
    """

    def __init__(self, settings: PointingSettings, tolerance: float = 1e-9, jitter: float = 0.0) -> None:
        self._settings, self._tolerance, self._jitter = settings, tolerance, jitter
        self._before: AxisCommand | None = None
        self._credit: dict[str, float] = {}    # s of full acceleration by axis, ahead of the commands' times

    def forget(self) -> None:
        """The next command starts a new sequence: it has no acceleration."""
        self._before = None

    def check(self, command: AxisCommand, elapsed: float) -> str:
        """The first fault of a command, '' for none.

        Parameters:
            command: the command.
            elapsed (s): time since the command before.
        """
        before, self._before = self._before, command
        axes = (('pan', command.pan, command.pan_rate, self._settings.pan),
                ('tilt', command.tilt, command.tilt_rate, self._settings.tilt),
                ('yaw', 0.0, command.yaw_rate, self._settings.yaw))
        for name, angle, rate, limits in axes:
            if not (math.isfinite(angle) and math.isfinite(rate)):
                return f'{name} is not finite: {angle} rad, {rate} rad/s'
            if not (limits.lower - self._tolerance <= angle <= limits.upper + self._tolerance
                    and abs(rate) <= limits.rate + self._tolerance):
                return f'{name} is out of its limits: {angle:.3g} rad, {rate:.3g} rad/s'
            change = 0.0 if before is None else abs(rate - getattr(before, f'{name}_rate'))
            credit = self._credit.get(name, self._jitter) + elapsed - change / limits.acceleration
            self._credit[name] = min(max(credit, 0.0), self._jitter)
            if credit < -self._tolerance / limits.acceleration:
                return f'{name} accelerates by {change:.3g} rad/s in {elapsed:.3g} s'
        return ''
