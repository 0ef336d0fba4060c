"""Odometry as plain numbers, read straight from its bytes: most messages of a bag are poses."""

from __future__ import annotations

import math
import struct
from typing import Any, NamedTuple

from av_common.stamps import to_seconds

# Header and child_frame_id come first; then position and attitude, 36 covariances, linear and angular velocity.
_YAW_RATE_AT = 8 * (7 + 36 + 5)
_FORMATS = [(struct.Struct(f'{order}iII').unpack_from, struct.Struct(f'{order}I').unpack_from,
             struct.Struct(f'{order}7d').unpack_from, struct.Struct(f'{order}d').unpack_from) for order in '><']


class Pose(NamedTuple):
    """Time in s, position in m in the world, attitude, and the body's yaw rate in rad/s."""

    time: float
    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float
    yaw_rate: float

    @property
    def has_attitude(self) -> bool:
        """Whether the quaternion is one: unknown attitudes are left at zero."""
        return self.qx**2 + self.qy**2 + self.qz**2 + self.qw**2 > 0.5

    @property
    def yaw(self) -> float:
        """Direction of the body's x axis seen from above, in rad."""
        return math.atan2(2.0 * (self.qw * self.qz + self.qx * self.qy),
                          self.qw**2 + self.qx**2 - self.qy**2 - self.qz**2)


def read_odometry(data: bytes) -> Pose:
    """The pose in a nav_msgs/Odometry in CDR (OMG DDSI-RTPS 10.2: values are aligned to their size, counted from byte 4).

    Raises ValueError when the bytes end early.
    """
    try:
        stamp, length, pose, real = _FORMATS[data[1]]
        seconds, nanoseconds, size = stamp(data, 4)
        at = 16 + size
        at += -at % 4
        at += 4 + length(data, at)[0]
        at += (4 - at) % 8
        return Pose(seconds + 1e-9 * nanoseconds, *pose(data, at), *real(data, at + _YAW_RATE_AT))
    except (struct.error, IndexError) as error:
        raise ValueError(f'{len(data)} bytes are no nav_msgs/Odometry: {error}') from error


def pose_of(message: Any) -> Pose:
    """The same of an Odometry message."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return Pose(to_seconds(message.header.stamp), p.x, p.y, p.z, q.x, q.y, q.z, q.w, message.twist.twist.angular.z)
