"""The node's parameters as settings of what they describe."""

from __future__ import annotations

import math

from av_common.limited_axis import AxisLimits
from av_px4.gimbal import ROLL_AND_PITCH_LOCK, GimbalSettings
from av_px4.guard import GuardSettings
from av_px4.nodes.px4_node_parameters import px4_node as parameters


def guard_settings(p: parameters.Params) -> GuardSettings:
    """The guard's limits. Raises ValueError where a stop would take too long."""
    return GuardSettings(math.radians(p.body.rate_deg), math.radians(p.body.acceleration_deg), p.timeouts.command,
                         p.timeouts.bearing, p.timeouts.attitude, p.timeouts.position, p.timeouts.status)


def gimbal_settings(p: parameters.Params) -> GimbalSettings:
    """The gimbal's ids and limits. Raises ValueError where a stop would take too long."""
    motion = (math.radians(p.gimbal.rate_deg), math.radians(p.gimbal.acceleration_deg))
    return GimbalSettings(
        component=p.component, gimbal_id=p.gimbal.id, flags=ROLL_AND_PITCH_LOCK if p.gimbal.lock_to_horizon else 0,
        pan=AxisLimits(*motion, *map(math.radians, p.gimbal.pan_limits_deg)),
        tilt=AxisLimits(*motion, *map(math.radians, p.gimbal.tilt_limits_deg)),
        ack_timeout=p.gimbal.ack_timeout, need_ack=p.gimbal.need_ack)
