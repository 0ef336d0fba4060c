"""Settings of pointing from the parameters of pointing_node."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from av_common.limited_axis import AxisLimits
from av_common.rig import GimbalMount
from av_pointing.controller import PointingSettings


def pointing_settings(p: Any) -> PointingSettings:
    """The settings that the parameters of pointing_node describe. Raises ValueError for stops that exclude 0."""
    for name in ('pan_limits_deg', 'tilt_limits_deg'):
        lower, upper = getattr(p, name)
        if not lower <= 0.0 <= upper:
            raise ValueError(f'{name} is [{lower:g}, {upper:g}], expected a lower and an upper limit around 0')
    reach = min(abs(limit) for limit in p.pan_limits_deg)
    if p.move_body and p.move_gimbal and p.body_follows_at_deg >= reach > 0.0:
        raise ValueError(f'body_follows_at_deg is {p.body_follows_at_deg:g}, where the pan of {list(p.pan_limits_deg)} deg '
                         f'does not go: the body would never follow; expected less than {reach:g}')
    gimbal = (math.radians(p.gimbal_rate_deg), math.radians(p.gimbal_acceleration_deg))
    return PointingSettings(
        pan=AxisLimits(*gimbal, *map(math.radians, p.pan_limits_deg)),
        tilt=AxisLimits(*gimbal, *map(math.radians, p.tilt_limits_deg)),
        yaw=AxisLimits(math.radians(p.yaw_rate_deg), math.radians(p.yaw_acceleration_deg)),
        coast=p.coast, on_stale=p.on_stale, move_gimbal=p.move_gimbal, move_body=p.move_body,
        body_follows_at=math.radians(p.body_follows_at_deg))


def with_gimbal(settings: PointingSettings, gimbal: GimbalMount | None) -> PointingSettings:
    """Settings within what a gimbal can do too, and in the frame in which it is commanded; unchanged without one.

    Parameters:
        settings: the settings.
        gimbal: the rig's gimbal.
    """
    if gimbal is None:
        return settings

    def within(axis: AxisLimits, limits_deg: tuple[float, float]) -> AxisLimits:
        lower, upper = map(math.radians, limits_deg)
        return AxisLimits(min(axis.rate, math.radians(gimbal.max_rate_deg)), axis.acceleration, max(axis.lower, lower),
                          min(axis.upper, upper))
    return replace(settings, pan=within(settings.pan, gimbal.pan_limits_deg),
                   tilt=within(settings.tilt, gimbal.tilt_limits_deg), stabilized=gimbal.stabilized)
