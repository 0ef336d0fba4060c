"""Poses of the rig from odometry messages."""

from __future__ import annotations

import math
from typing import Any

from nav_msgs.msg import Odometry

from av_common.frames import attitude_of, is_orientation
from av_common.stamps import to_seconds
from av_fusion.measurement.rig_motion import RATE_LIMIT, SPEED_LIMIT, Pose
from av_fusion.measurement.vectors import ZERO, Vector


def pose_of(message: Odometry) -> Pose | None:
    """The pose of an Odometry (pose in ENU, twist in the body frame, FLU); None without attitude."""
    attitude, twist, position = attitude_of(message.pose.pose.orientation), message.twist.twist, message.pose.pose.position
    if not is_orientation(attitude):
        return None
    return Pose(to_seconds(message.header.stamp), attitude,
                _usable(twist.angular, RATE_LIMIT) or ZERO, _usable(twist.linear, SPEED_LIMIT) or ZERO,
                _usable(position, math.inf))


def _usable(message: Any, limit: float) -> Vector | None:
    """A vector of three finite values within +-limit, else None: an estimator may know the attitude alone."""
    vector = message.x, message.y, message.z
    return vector if all(math.isfinite(value) and abs(value) <= limit for value in vector) else None
