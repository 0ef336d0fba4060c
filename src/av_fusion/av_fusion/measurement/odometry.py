"""Yaw of the rig from odometry messages."""

from __future__ import annotations

from nav_msgs.msg import Odometry

from av_common.frames import attitude_of, yaw_of
from av_common.stamps import to_seconds
from av_fusion.tracker_protocol import Tracker


def add_odometry(tracker: Tracker, message: Odometry) -> None:
    """Give a tracker the yaw and yaw rate of an Odometry; one without attitude (a zero quaternion) is ignored.

    Parameters:
        tracker: the tracker.
        message: a nav_msgs/Odometry in ENU.
    """
    q = message.pose.pose.orientation
    if q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w > 0.5:
        tracker.add_pose(to_seconds(message.header.stamp), yaw_of(attitude_of(q)), message.twist.twist.angular.z)
