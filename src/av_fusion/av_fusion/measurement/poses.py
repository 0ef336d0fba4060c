"""Odometry as plain numbers, read straight from its bytes: most messages, live and in bags, are poses."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from av_common.stamps import to_seconds

# Header and child_frame_id come first; then position and attitude, 36 covariances, linear and angular velocity.
_YAW_RATE_AT = 8 * (7 + 36 + 5)
_FORMATS = [(struct.Struct(f'{order}iII').unpack_from, struct.Struct(f'{order}I').unpack_from,
             struct.Struct(f'{order}7d').unpack_from, struct.Struct(f'{order}d').unpack_from) for order in '><']


class Pose(NamedTuple):
    """Time in s, position in m in the world, attitude, and the body's yaw rate in rad/s; or columns (n,) of them."""

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
        return self.qx * self.qx + self.qy * self.qy + self.qz * self.qz + self.qw * self.qw > 0.5

    @property
    def attitude(self) -> tuple[float, float, float, float]:
        """The quaternion as (w, x, y, z)."""
        return self.qw, self.qx, self.qy, self.qz


def read_odometry(data: bytes) -> Pose:
    """The pose in a nav_msgs/Odometry in CDR (OMG DDSI-RTPS 10.2: values are aligned to their size, counted from byte 4).

    Raises ValueError when the bytes end early.
    """
    try:
        stamp, _, pose, real = _FORMATS[data[1]]
        seconds, nanoseconds, _ = stamp(data, 4)
        at = _place(data)
        return Pose._make((seconds + 1e-9 * nanoseconds, *pose(data, at), *real(data, at + _YAW_RATE_AT)))
    except (struct.error, IndexError) as error:
        raise ValueError(f'{len(data)} bytes are no nav_msgs/Odometry: {error}') from error


def read_alike(messages: Sequence[bytes]) -> Pose | None:
    """Columns of the poses in many nav_msgs/Odometry that differ in numbers only; None where they differ in more."""
    size = len(messages[0])
    try:
        at = _place(messages[0])
    except (struct.error, IndexError):
        return None
    if set(map(len, messages)) != {size} or size < at + _YAW_RATE_AT + 8:
        return None
    table = np.frombuffer(b''.join(messages), np.uint8).reshape(-1, size)
    if (table[:, :4] != table[0, :4]).any() or (table[:, 12:at] != table[0, 12:at]).any():
        return None
    order = '><'[messages[0][1]]
    stamps, pose, yaw_rate = (np.ascontiguousarray(table[:, first:last]).view(f'{order}{kind}') for first, last, kind in (
        (4, 12, 'u4'), (at, at + 56, 'f8'), (at + _YAW_RATE_AT, at + _YAW_RATE_AT + 8, 'f8')))
    return Pose(stamps[:, 0].astype(np.int32) + 1e-9 * stamps[:, 1], *pose.T, *yaw_rate.T)


def _place(data: bytes) -> int:
    """Where position and attitude are in a nav_msgs/Odometry. Raises struct.error or IndexError when the bytes end early."""
    stamp, length, _, _ = _FORMATS[data[1]]
    at = 16 + stamp(data, 4)[2]
    at += -at % 4
    at += 4 + length(data, at)[0]
    return at + (4 - at) % 8


def pose_of(message: Any) -> Pose:
    """The same of an Odometry message."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return Pose(to_seconds(message.header.stamp), p.x, p.y, p.z, q.x, q.y, q.z, q.w, message.twist.twist.angular.z)
