"""Poses of vehicles, vectors and quaternions as messages."""

from __future__ import annotations

from collections.abc import Iterable

from geometry_msgs.msg import Quaternion, Vector3
from nav_msgs.msg import Odometry
from std_msgs.msg import Header


def odometry_message(header: Header, child_frame: str, position: Iterable[float], attitude_wxyz: Iterable[float],
                     velocity_flu: Iterable[float], rate_flu: Iterable[float]) -> Odometry:
    """The pose and twist of a vehicle.

    Parameters:
        header: stamp, and the frame of the pose (ENU).
        child_frame: frame of the vehicle's body (FLU), to which the twist refers.
        position (m, (3,)), attitude_wxyz (4,): the pose.
        velocity_flu (m/s, (3,)), rate_flu (rad/s, (3,)): the twist.
    """
    message = Odometry(header=header, child_frame_id=child_frame)
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = map(float, position)
    pose.orientation = quaternion_message(attitude_wxyz)
    twist.linear, twist.angular = vector_message(velocity_flu), vector_message(rate_flu)
    return message


def vector_message(values: Iterable[float]) -> Vector3:
    """Three numbers."""
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def quaternion_message(wxyz: Iterable[float]) -> Quaternion:
    """A quaternion (w, x, y, z)."""
    w, x, y, z = map(float, wxyz)
    return Quaternion(w=w, x=x, y=y, z=z)
