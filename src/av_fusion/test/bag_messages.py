"""Messages for the tests of bags, made by rosbags' own types: nothing of what is tested makes them."""

from __future__ import annotations

import numpy as np
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_HUMBLE)
ODOMETRY = 'nav_msgs/msg/Odometry'


def make(kind: str, *values: object) -> object:
    return TYPES.types[kind](*values)


def header(time: float, frame: str = 'base_link') -> object:
    nanoseconds = round(time * 1e9)
    return make('std_msgs/msg/Header', make('builtin_interfaces/msg/Time', *divmod(nanoseconds, 10**9)), frame)


def odometry(time: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, yaw_rate: float = 0.0) -> object:
    pose = make('geometry_msgs/msg/Pose', make('geometry_msgs/msg/Point', x, y, 0.0),
                make('geometry_msgs/msg/Quaternion', 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
    zero = make('geometry_msgs/msg/Vector3', 0.0, 0.0, 0.0)
    twist = make('geometry_msgs/msg/Twist', zero, make('geometry_msgs/msg/Vector3', 0.0, 0.0, yaw_rate))
    return make(ODOMETRY, header(time, 'map'), 'base_link',
                make('geometry_msgs/msg/PoseWithCovariance', pose, np.zeros(36)),
                make('geometry_msgs/msg/TwistWithCovariance', twist, np.zeros(36)))


def cdr(message: object) -> bytes:
    return bytes(TYPES.serialize_cdr(message, message.__msgtype__))
