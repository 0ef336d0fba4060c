"""Settings of the stage, and their conversion from the node's parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from av_common.limited_axis import AxisLimits
from av_px4.gimbal import ROLL_AND_PITCH_LOCK, GimbalSettings
from av_px4.guard import GuardSettings


@dataclass(frozen=True)
class Px4Settings:
    """Settings of Px4Stage.

    Parameters:
        guard: limits of the body motion, and the maximum ages of the inputs
        gimbal: ids and limits of the gimbal
        use_gimbal: whether the gimbal is claimed and pointed
        lock_to_horizon: whether the gimbal expects angles relative to the horizon
        turn_body: whether the OFFBOARD heartbeat is sent and the vehicle is turned in that mode
        external_mode: name of the external mode to register, empty for none
        rate (Hz): rate of control steps while no pointing command arrives
        odom_frame: frame of the odometry
        base_frame: frame of the vehicle's body
        gimbal_frame: frame of the gimbal
    """

    guard: GuardSettings = field(default_factory=GuardSettings)
    gimbal: GimbalSettings = field(default_factory=GimbalSettings)
    use_gimbal: bool = True
    lock_to_horizon: bool = True
    turn_body: bool = True
    external_mode: str = ''
    rate: float = 50.0
    odom_frame: str = 'odom'
    base_frame: str = 'base_link'
    gimbal_frame: str = 'gimbal_link'


def px4_settings(p: Any) -> Px4Settings:
    """The settings given by px4_node's parameters. Raises ValueError for limits with which a stop would take too long."""
    return Px4Settings(
        guard=_guard_settings(p), gimbal=_gimbal_settings(p), use_gimbal=p.gimbal.enabled,
        lock_to_horizon=p.gimbal.lock_to_horizon, turn_body=p.turn_body,
        external_mode=p.external_mode_name if p.external_mode else '', rate=p.rate, odom_frame=p.odom_frame,
        base_frame=p.base_frame, gimbal_frame=p.gimbal.frame)


def _guard_settings(p: Any) -> GuardSettings:
    return GuardSettings(math.radians(p.body.rate_deg), math.radians(p.body.acceleration_deg), p.timeouts.command,
                         p.timeouts.bearing, p.timeouts.attitude, p.timeouts.position, p.timeouts.status)


def _gimbal_settings(p: Any) -> GimbalSettings:
    motion = (math.radians(p.gimbal.rate_deg), math.radians(p.gimbal.acceleration_deg))
    return GimbalSettings(
        component=p.component, gimbal_id=p.gimbal.id, flags=ROLL_AND_PITCH_LOCK if p.gimbal.lock_to_horizon else 0,
        pan=AxisLimits(*motion, *map(math.radians, p.gimbal.pan_limits_deg)),
        tilt=AxisLimits(*motion, *map(math.radians, p.gimbal.tilt_limits_deg)),
        ack_timeout=p.gimbal.ack_timeout, need_ack=p.gimbal.need_ack)
