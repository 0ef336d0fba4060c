"""Settings from the parameters of pointing_node, and the rig's gimbal."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from av_common.limited_axis import AxisLimits
from av_common.rig import UNDESCRIBED_GIMBAL, GimbalMount
from av_pointing.controller import PointingSettings

GIMBAL_ACCELERATION = math.radians(360.0)  # rad/s^2: 120 deg/s, the usual rate, is reached and left in a third of a second


def pointing_settings(p: Any, gimbal: GimbalMount | None = None) -> PointingSettings:
    """The settings that the parameters of pointing_node describe. Raises ValueError for a body that would never follow.

    Parameters:
        p: the parameters.
        gimbal: the rig's gimbal; None where its description has none.
    """
    reach = min(abs(limit) for limit in (gimbal or UNDESCRIBED_GIMBAL).pan_limits_deg)
    if p.move_body and p.move_gimbal and p.body_follows_at_deg >= reach > 0.0:
        raise ValueError(f'body_follows_at_deg is {p.body_follows_at_deg:g}, where the pan of the gimbal does not go: the body '
                         f'would never follow; expected less than {reach:g}')
    return with_gimbal(PointingSettings(
        yaw=AxisLimits(math.radians(p.yaw_rate_deg), math.radians(p.yaw_acceleration_deg)),
        coast=p.coast, neutral=p.on_stale == 'neutral', move_gimbal=p.move_gimbal, move_body=p.move_body,
        body_follows_at=math.radians(p.body_follows_at_deg)), gimbal)


def with_gimbal(settings: PointingSettings, gimbal: GimbalMount | None) -> PointingSettings:
    """Settings within what a gimbal can do, and in the frame in which it is commanded.

    Parameters:
        settings: the settings.
        gimbal: the rig's gimbal; None where its description has none.
    """
    mount = gimbal or UNDESCRIBED_GIMBAL

    def axis(limits_deg: tuple[float, float]) -> AxisLimits:
        return AxisLimits(math.radians(mount.max_rate_deg), GIMBAL_ACCELERATION, *map(math.radians, limits_deg))
    return replace(settings, pan=axis(mount.pan_limits_deg), tilt=axis(mount.tilt_limits_deg), stabilized=mount.stabilized)
