"""Conversions between the frames of aerospace (NED, FRD), of ROS (ENU, FLU; REP-103) and of cameras (optical).

Quaternions are (w, x, y, z) unless a name says otherwise, as in transforms3d; ROS messages hold (x, y, z, w).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from transforms3d.euler import euler2mat

# Names of REP-105, as all nodes publish them: a rig in a namespace has tf of its own.
BASE_FRAME, ODOM_FRAME, MAP_FRAME = 'base_link', 'odom', 'map'
# Rows are the axes of the target frame in the source frame. Both are their own inverse.
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_TO_FLU = np.diag([1.0, -1.0, -1.0])
# Camera body (x forward, y left, z up) to optical (x right, y down, z forward), REP-103.
FLU_TO_OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
UNIT_TOLERANCE = 0.01  # of the squared norm of a quaternion: tf2 refuses transforms beyond it, too (buffer_core.cpp)


def ned_to_enu(vector: ArrayLike) -> NDArray:
    """World vectors (..., 3) from north-east-down to east-north-up, or back."""
    return np.asarray(vector, float) @ NED_TO_ENU.T


def frd_to_flu(vector: ArrayLike) -> NDArray:
    """Body vectors (..., 3) from forward-right-down to forward-left-up, or back."""
    return np.asarray(vector, float) @ FRD_TO_FLU.T


def attitude_ned_to_enu(quaternion: Iterable[float]) -> NDArray:
    """Unit attitude (w, x, y, z) of the FRD body in NED as that of the FLU body in ENU, or back; w is not negative.

    The result is q1 q q2 with q1 = (0, 1, 1, 0) / sqrt(2), the half turn that swaps north and east, and q2 = (0, 1, 0, 0).
    """
    w, x, y, z = map(float, quaternion)  # plain numbers: as fast as needed for each pose of an autopilot
    turned = np.array([w + z, x + y, x - y, w - z]) / (math.sqrt(2.0) * math.hypot(w, x, y, z))
    return turned if turned[0] >= 0.0 else -turned


def attitude_of(orientation: Any) -> tuple[float, float, float, float]:
    """Attitude (w, x, y, z) of a `geometry_msgs/Quaternion`."""
    return orientation.w, orientation.x, orientation.y, orientation.z


def is_orientation(quaternion: Iterable[float]) -> bool:
    """Whether a quaternion is an orientation: of norm 1. A zero one, by which senders say that they know none, is not."""
    return bool(abs(sum(part * part for part in map(float, quaternion)) - 1.0) < UNIT_TOLERANCE)


def checked_orientation(quaternion: Iterable[float], name: str) -> tuple[float, float, float, float]:
    """A quaternion, of norm 1 to the last digit.

    Parameters:
        quaternion: (w, x, y, z).
        name: what it is, for the message.

    Raises ValueError for one that is no orientation.
    """
    w, x, y, z = map(float, quaternion)
    norm = math.hypot(w, x, y, z)
    if not is_orientation((w, x, y, z)):
        raise ValueError(f'{name} of norm {norm:.3g}, expected 1')
    return w / norm, x / norm, y / norm, z / norm


def heading_of(quaternion: Sequence[Any]) -> tuple[Any, Any]:
    """Sine and cosine of the yaw, both multiplied by the squared norm of the attitude (w, x, y, z); also for arrays."""
    w, x, y, z = quaternion
    return 2.0 * (w * z + x * y), w * w + x * x - y * y - z * z


def yaw_of(quaternion: Sequence[float]) -> float:
    """Yaw in rad of an attitude (w, x, y, z) of any norm: the direction of the body's x axis seen from above."""
    return math.atan2(*heading_of(quaternion))


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> NDArray:
    """Rotation matrix (3, 3) of fixed-axis roll, pitch, yaw in rad (REP-103), from the rotated frame to its parent.

    Parameters:
        roll, pitch, yaw (rad): rotations about the fixed axes x, y, z, in this order.
    """
    return euler2mat(roll, pitch, yaw, 'sxyz')
