"""Settings of the controller, from the parameters of pointing_node and the rig's gimbal."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from av_common.limited_axis import AxisLimits
from av_common.rig import UNDESCRIBED_GIMBAL, GimbalMount
from av_pointing.response import Response

GIMBAL_ACCELERATION = math.radians(360.0)  # rad/s^2: 120 deg/s, the usual rate, is reached and left in a third of a second


@dataclass(frozen=True)
class PointingSettings:
    """Settings of `PointingController`.

    Parameters:
        gimbal: how it is mounted, its limits, its rate, and whether it stays level.
        yaw: limits of the body's yaw rate and acceleration.
        response: expected answer of the vehicle to yaw rates, from which its estimate starts; by default that of PX4.
        coast (s): time after the newest measurement's arrival for which the gimbal follows a prediction.
        neutral: whether the gimbal returns to 0 while the bearing is stale; else it stops.
        move_gimbal, move_body: whether gimbal and body are commanded.
        body_follows_at (rad): pan from which the body follows a moving gimbal.
    """

    gimbal: GimbalMount = UNDESCRIBED_GIMBAL
    yaw: AxisLimits = field(default_factory=lambda: AxisLimits(math.radians(45), math.radians(900)))
    response: Response = field(default_factory=Response)
    coast: float = 2.0
    neutral: bool = False
    move_gimbal: bool = True
    move_body: bool = True
    body_follows_at: float = math.radians(30.0)

    @property
    def pan(self) -> AxisLimits:
        """Limits of the gimbal's pan."""
        return self._axis(self.gimbal.pan_limits_deg)

    @property
    def tilt(self) -> AxisLimits:
        """Limits of the gimbal's tilt."""
        return self._axis(self.gimbal.tilt_limits_deg)

    def _axis(self, limits_deg: tuple[float, float]) -> AxisLimits:
        return AxisLimits(math.radians(self.gimbal.max_rate_deg), GIMBAL_ACCELERATION, *map(math.radians, limits_deg))


def pointing_settings(p: Any, gimbal: GimbalMount | None = None) -> PointingSettings:
    """The settings that the parameters of pointing_node describe. Raises ValueError for a body that would never follow.

    Parameters:
        p: the parameters.
        gimbal: the rig's gimbal; None where its description has none.
    """
    mount = gimbal or UNDESCRIBED_GIMBAL
    reach = min(abs(limit) for limit in mount.pan_limits_deg)
    if p.move_body and p.move_gimbal and p.body_follows_at_deg >= reach > 0.0:
        raise ValueError(f'body_follows_at_deg is {p.body_follows_at_deg:g}, where the pan of the gimbal does not go: the body '
                         f'would never follow; expected less than {reach:g}')
    return PointingSettings(
        mount, AxisLimits(math.radians(p.yaw_rate_deg), math.radians(p.yaw_acceleration_deg)), coast=p.coast,
        neutral=p.on_stale == 'neutral', move_gimbal=p.move_gimbal, move_body=p.move_body,
        body_follows_at=math.radians(p.body_follows_at_deg))
