"""Settings of the stage, and their conversion from the node's parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from av_common.limited_axis import AxisLimits
from av_common.rig import UNDESCRIBED_GIMBAL, GimbalMount
from av_px4.gimbal import ROLL_AND_PITCH_LOCK, AfterTakeover, GimbalSettings
from av_px4.odometry import RADIANS_PER_RPM

MODE_NAME = 'AV Track'    # in the ground station
GIMBAL_STOPS_S = 0.2      # time in which the gimbal's acceleration stops its fastest turn


@dataclass(frozen=True)
class Px4Settings:
    """Settings of Px4Stage.

    Parameters:
        max_rate (rad/s): largest yaw rate of the body
        gimbal: limits of the gimbal
        use_gimbal: whether the gimbal is claimed and pointed
        lock_to_horizon: whether the gimbal expects angles relative to the horizon
        turn_body: whether the body is turned in any mode
        offboard: whether it is turned in OFFBOARD, too, and the heartbeat sent that the pilot needs to select that mode
        external_mode: name of the external mode to register, empty for none
        full_speed (rad/s): of a motor at full command; 0 where it is not known
        gimbal_frame: frame of the gimbal
    """

    max_rate: float = math.radians(30.0)
    gimbal: GimbalSettings = field(default_factory=GimbalSettings)
    use_gimbal: bool = True
    lock_to_horizon: bool = True
    turn_body: bool = True
    offboard: bool = False
    external_mode: str = MODE_NAME
    full_speed: float = 0.0
    gimbal_frame: str = 'gimbal_link'


def px4_settings(p: Any, gimbal: GimbalMount | None = None) -> Px4Settings:
    """The settings given by px4_node's parameters. Raises ValueError for a gimbal that could not be stopped.

    Parameters:
        p: the parameters.
        gimbal: the rig's gimbal; None where its description has none.
    """
    mount = gimbal or replace(UNDESCRIBED_GIMBAL, stabilized=True)
    rate = math.radians(mount.max_rate_deg)
    motion = (rate, rate / GIMBAL_STOPS_S)
    return Px4Settings(
        max_rate=math.radians(p.body.rate_deg), use_gimbal=p.gimbal.enabled,
        gimbal=GimbalSettings(
            flags=ROLL_AND_PITCH_LOCK if mount.stabilized else 0,
            pan=AxisLimits(*motion, *map(math.radians, mount.pan_limits_deg)),
            tilt=AxisLimits(*motion, *map(math.radians, mount.tilt_limits_deg)),
            need_ack=p.gimbal.need_ack, after_takeover=AfterTakeover(p.gimbal.after_takeover)),
        lock_to_horizon=mount.stabilized, turn_body=p.turn_body, offboard=p.offboard,
        external_mode=MODE_NAME if p.external_mode else '', full_speed=RADIANS_PER_RPM * p.motors.full_rpm,
        gimbal_frame=mount.frame)
