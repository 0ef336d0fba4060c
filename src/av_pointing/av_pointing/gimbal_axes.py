"""Pan and tilt of the gimbal: they follow directions within their limits of angle, rate and acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.gimbal_geometry import LEVEL, stabilized_to_body
from av_common.limited_axis import AxisLimits, LimitedAxis

STEEP = math.radians(89.0)  # tilt from which a pan means nothing


class GimbalAxes:
    """The commanded angles of a gimbal, in the frame that its commands are in.

    Commands of a stabilized gimbal are in `base_stabilized`, which has the body's heading and neither roll nor pitch; those of
    another one in the body's frame.

    Attributes:
        pan, tilt: the axes.
        stabilized: whether the gimbal stays level as the body tilts.

    Parameters:
        pan, tilt: limits of the axes.
        stabilized: see the attribute.
        dead_band (rad): error below which nothing moves.
    """

    def __init__(self, pan: AxisLimits, tilt: AxisLimits, stabilized: bool, dead_band: float) -> None:
        self.pan, self.tilt, self.stabilized = LimitedAxis(pan), LimitedAxis(tilt), stabilized
        self._dead_band = dead_band
        self._attitude: Sequence[float] = LEVEL

    def start_at(self, pan: float, tilt: float) -> None:
        """Stand still at angles (rad), within the limits."""
        for axis, angle in ((self.pan, pan), (self.tilt, tilt)):
            axis.position, axis.velocity = min(max(angle, axis.limits.lower), axis.limits.upper), 0.0

    def on_attitude(self, attitude_wxyz: Sequence[float]) -> None:
        """Note the body's attitude (w, x, y, z) of any norm but 0 in the world (ENU)."""
        norm = math.sqrt(sum(part * part for part in attitude_wxyz))
        self._attitude = tuple(part / norm for part in attitude_wxyz)

    def of_body(self, azimuth: float, elevation: float) -> tuple[float, float]:
        """Pan and tilt (rad) of a direction in the body's frame, as the body is tilted now."""
        if not self.stabilized:
            return azimuth, elevation
        return _angles(stabilized_to_body(self._attitude).T @ angles_to_direction(azimuth, elevation))

    def of_level(self, azimuth: float, elevation: float) -> tuple[float, float]:
        """Pan and tilt (rad) of a direction given by its angle from the body's heading, and its elevation in the world."""
        if self.stabilized:
            return azimuth, elevation
        return _angles(stabilized_to_body(self._attitude) @ angles_to_direction(azimuth, elevation))

    def follow(self, dt: float, pan: float | None, tilt: float | None, rate: float = math.inf, pan_rate: float = 0.0) -> None:
        """Turn towards angles; an axis without one brakes.

        Parameters:
            dt (s): duration of the step.
            pan, tilt (rad): the angles; pan by the turn that is closest and within the limits.
            rate (rad/s): limit of the rates, in addition to those of the axes.
            pan_rate (rad/s): rate of `pan` itself.
        """
        if pan is None or (tilt is not None and abs(tilt) > STEEP):
            self.pan.stop(dt)
        else:
            self.pan.follow(self._beyond(self._turn(pan) - self.pan.position), pan_rate, dt, rate)
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
        """The angle within the limits that is closest to `pan` by any number of whole turns, and closest to the present one."""
        limits = self.pan.limits

        def cost(turned: float) -> tuple[float, float]:
            within = min(max(turned, limits.lower), limits.upper)
            return round(abs(turned - within), 9), abs(turned - self.pan.position)
        best = min((math.remainder(pan, math.tau) + turn for turn in (-math.tau, 0.0, math.tau)), key=cost)
        return min(max(best, limits.lower), limits.upper)

    def _beyond(self, error: float) -> float:
        return math.copysign(max(abs(error) - self._dead_band, 0.0), error)


def _angles(direction: object) -> tuple[float, float]:
    azimuth, elevation = direction_to_angles(direction)  # type: ignore[arg-type]
    return float(azimuth), float(elevation)
