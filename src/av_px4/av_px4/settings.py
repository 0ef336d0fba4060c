"""Settings of the stage, and their conversion from the node's parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from av_common.rig import GimbalMount
from av_px4.gimbal import DEFAULT_MOUNT, AfterTakeover, GimbalSettings
from av_px4.odometry import RADIANS_PER_RPM


@dataclass(frozen=True)
class Px4Settings:
    """Settings of Px4Stage.

    Parameters:
        max_rate (rad/s): largest yaw rate of the body
        gimbal: the gimbal and how it is claimed
        use_gimbal: whether the gimbal is claimed and pointed
        turn_body: whether the body is turned in any mode
        offboard: whether it is turned in OFFBOARD, too, and the heartbeat sent that the pilot needs to select that mode
        external_mode: whether the external mode is registered
        full_speed (rad/s): of a motor at full command; 0 where it is not known
    """

    max_rate: float = math.radians(30.0)
    gimbal: GimbalSettings = field(default_factory=GimbalSettings)
    use_gimbal: bool = True
    turn_body: bool = True
    offboard: bool = False
    external_mode: bool = True
    full_speed: float = 0.0


def px4_settings(p: Any, gimbal: GimbalMount | None = None) -> Px4Settings:
    """The settings given by px4_node's parameters.

    Parameters:
        p: the parameters.
        gimbal: the rig's gimbal; None where its description has none.
    """
    return Px4Settings(
        max_rate=math.radians(p.body.rate_deg), use_gimbal=p.gimbal.enabled,
        gimbal=GimbalSettings(gimbal or DEFAULT_MOUNT, p.gimbal.need_ack, AfterTakeover(p.gimbal.after_takeover)),
        turn_body=p.turn_body, offboard=p.offboard, external_mode=p.external_mode,
        full_speed=RADIANS_PER_RPM * p.motors.full_rpm)
