"""Heading of the rig in odometry messages."""

from __future__ import annotations

from typing import Any

from av_common.frames import yaw_of
from av_common.stamps import to_seconds


def add_odometry(tracker: Any, message: Any) -> None:
    """Give a tracker the yaw and yaw rate of an Odometry; one without attitude (a zero quaternion) is ignored."""
    q = message.pose.pose.orientation
    if q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w > 0.5:
        tracker.add_pose(to_seconds(message.header.stamp), yaw_of((q.w, q.x, q.y, q.z)), message.twist.twist.angular.z)
