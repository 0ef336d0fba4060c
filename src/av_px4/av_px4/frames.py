"""Between PX4's frames (NED, FRD, clockwise yaw) and those of ROS (ENU, FLU, counter-clockwise yaw)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from transforms3d.quaternions import quat2mat

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.frames import attitude_ned_to_enu, frd_to_flu, ned_to_enu, yaw_of

# px4_msgs/VehicleOdometry's numbers of frames.
POSE_FRAME_NED = 1
VELOCITY_FRAME_NED, VELOCITY_FRAME_FRD, VELOCITY_FRAME_BODY_FRD = 1, 2, 3


@dataclass(frozen=True)
class Pose:
    """Position m (3,) in ENU, attitude (w, x, y, z) from FLU to ENU, velocity m/s and turn rate rad/s (3,) in FLU."""

    position: NDArray
    attitude_wxyz: NDArray
    velocity_flu: NDArray
    rate_flu: NDArray

    @property
    def yaw(self) -> float:
        """Rad, counter-clockwise from east."""
        return yaw_of(self.attitude_wxyz)


def pose_from_px4(position_ned: ArrayLike, attitude: ArrayLike, velocity: ArrayLike, rate_frd: ArrayLike,
                  pose_frame: int = POSE_FRAME_NED, velocity_frame: int = VELOCITY_FRAME_NED) -> Pose:
    """A pose in ROS's frames. What PX4 does not know (NaN) becomes 0, but for the attitude.

    attitude: (w, x, y, z), NED <- FRD. Raises ValueError for what is no attitude, or in a frame that is not NED.
    """
    if pose_frame != POSE_FRAME_NED:
        raise ValueError(f'pose_frame is {pose_frame}, expected {POSE_FRAME_NED} (NED)')
    norm = math.hypot(*map(float, attitude))
    if not abs(norm - 1.0) < 0.1:  # not >: NaN is refused, too
        raise ValueError(f'attitude has norm {norm:.3g}, expected 1')
    enu = attitude_ned_to_enu(attitude)
    position, velocity, rate = np.nan_to_num(np.array([position_ned, velocity, rate_frd], float))
    velocity_flu = (quat2mat(enu).T @ ned_to_enu(velocity) if velocity_frame == VELOCITY_FRAME_NED
                    else frd_to_flu(velocity) if velocity_frame == VELOCITY_FRAME_BODY_FRD else np.zeros(3))
    return Pose(ned_to_enu(position), enu, velocity_flu, frd_to_flu(rate))


def gimbal_degrees(pan: float, tilt: float) -> tuple[float, float]:
    """Pitch (up) and yaw (to the right) in degrees, as MAVLink has them, of pan (to the left) and tilt (up) in rad."""
    return math.degrees(tilt), -math.degrees(pan)


def gimbal_angles(attitude: ArrayLike) -> tuple[float, float]:
    """Pan and tilt in rad of a gimbal's attitude (w, x, y, z), FRD in the vehicle's forward-right-down frame."""
    forward = frd_to_flu(quat2mat(np.asarray(attitude, float))[:, 0])
    pan, tilt = direction_to_angles(forward)
    return float(pan), float(tilt)


def levelled(pan: float, tilt: float, attitude_wxyz: ArrayLike) -> tuple[float, float]:
    """Pan and tilt (rad) seen from the horizon, of a direction seen from a body of that attitude (FLU to ENU).

    A gimbal whose roll and pitch are locked to the horizon is told these.
    """
    direction = quat2mat(np.asarray(attitude_wxyz, float)) @ angles_to_direction(pan, tilt)
    azimuth, elevation = direction_to_angles(direction)
    azimuth = float(azimuth) - yaw_of(attitude_wxyz)
    # pan may lie beyond half a turn: stay on its branch
    return azimuth + 2.0 * math.pi * round((pan - azimuth) / (2.0 * math.pi)), float(elevation)


def yawspeed_ned(yaw_rate: float) -> float:
    """PX4's yaw speed (rad/s, clockwise seen from above) of a yaw rate (rad/s, counter-clockwise), or back."""
    return -yaw_rate
