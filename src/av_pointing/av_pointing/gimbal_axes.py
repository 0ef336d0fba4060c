"""Pan and tilt of the gimbal: they follow directions within their limits of angle, rate and acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence

from av_common.gimbal_geometry import LEVEL, angles_of_command, command_of_angles, sense_of
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.rig import GimbalMount

STEEP = math.radians(89.0)  # tilt from which a pan means nothing
# Angle off the target, at a stop, that a whole turn to the other stop is worth: half a camera's view, which shows it there.
OFF_BY_TURN = math.radians(20.0) / math.tau


class GimbalAxes:
    """The commanded angles of a gimbal.

    Attributes:
        pan, tilt: the axes of its mount.
        attitude_wxyz: the body's attitude (w, x, y, z) in the world (ENU).

    Parameters:
        gimbal: how it is mounted.
        pan, tilt: limits of the axes.
        dead_band (rad): error below which nothing moves.
    """

    def __init__(self, gimbal: GimbalMount, pan: AxisLimits, tilt: AxisLimits, dead_band: float) -> None:
        self.pan, self.tilt = LimitedAxis(pan), LimitedAxis(tilt)
        self._gimbal, self._dead_band = gimbal, dead_band
        self.attitude_wxyz: Sequence[float] = LEVEL

    @property
    def command(self) -> tuple[float, float, float, float]:
        """Pan and tilt (rad) and their rates (rad/s) in `base_stabilized` for a stabilized gimbal, else in the body's frame."""
        sense = sense_of(self._gimbal)
        return (*command_of_angles(self._gimbal, self.pan.position, self.tilt.position),
                sense * self.pan.velocity, sense * self.tilt.velocity)

    def start_at(self, pan: float, tilt: float) -> None:
        """Begin at angles (rad) of the axes, as the process before left them; the next step brings them within the limits."""
        self.pan.position, self.tilt.position = pan, tilt

    def of_body(self, azimuth: float, elevation: float) -> tuple[float, float]:
        """Pan and tilt (rad) of a direction in the body's frame, as the body is tilted now."""
        return angles_of_command(self._gimbal, azimuth, elevation, False, self.attitude_wxyz)

    def of_level(self, azimuth: float, elevation: float) -> tuple[float, float]:
        """Pan and tilt (rad) of a direction given by its angle from the body's heading, and its elevation in the world."""
        return angles_of_command(self._gimbal, azimuth, elevation, True, self.attitude_wxyz)

    def follow(self, dt: float, pan: float | None, tilt: float | None, rate: float = math.inf, pan_rate: float = 0.0) -> None:
        """Turn towards angles; an axis without one brakes.

        Parameters:
            dt (s): duration of the step.
            pan, tilt (rad): the angles; pan by the turn that is closest and within the limits.
            rate (rad/s): limit of the rates, in addition to those of the axes.
            pan_rate (rad/s): rate of the direction itself, counter-clockwise.
        """
        if pan is None or (tilt is not None and abs(tilt) > STEEP):
            self.pan.stop(dt)
        else:
            self.pan.follow(self._beyond(self._turn(pan) - self.pan.position), sense_of(self._gimbal) * pan_rate, dt, rate)
        if tilt is None:
            self.tilt.stop(dt)
        else:
            limits = self.tilt.limits
            self.tilt.follow(self._beyond(min(max(tilt, limits.lower), limits.upper) - self.tilt.position), 0.0, dt, rate)

    def hold(self, dt: float, neutral: bool) -> None:
        """Brake, or return to 0.

        Parameters:
            dt (s): duration of the step.
            neutral: whether to return to 0.
        """
        for axis in (self.pan, self.tilt):
            if neutral:
                axis.follow(-axis.position, 0.0, dt)
            else:
                axis.stop(dt)

    def _turn(self, pan: float) -> float:
        """The angle within the limits that is closest to `pan` by any number of whole turns, the way there counted, too."""
        limits = self.pan.limits
        turned = (math.remainder(pan, math.tau) + turn for turn in (-math.tau, 0.0, math.tau))
        nearest = ((angle, min(max(angle, limits.lower), limits.upper)) for angle in turned)
        return min(nearest, key=lambda ends: abs(ends[0] - ends[1]) + OFF_BY_TURN * abs(ends[1] - self.pan.position))[1]

    def _beyond(self, error: float) -> float:
        return math.copysign(max(abs(error) - self._dead_band, 0.0), error)
