"""Conversion between PX4's frames (NED, FRD, clockwise yaw) and those of ROS (ENU, FLU, counter-clockwise yaw)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import quat2mat

from av_common.frames import attitude_ned_to_enu, checked_orientation, frd_to_flu, ned_to_enu, yaw_of

Floats: TypeAlias = Sequence[float] | NDArray
# px4_msgs/VehicleOdometry's numbers of frames.
POSE_FRAME_NED = 1
VELOCITY_FRAME_NED, VELOCITY_FRAME_FRD, VELOCITY_FRAME_BODY_FRD = 1, 2, 3
LARGEST = 1e6    # m, m/s, rad/s; a larger number is no pose


@dataclass(frozen=True)
class Pose:
    """Pose and twist of the vehicle in ROS's frames.

    Parameters:
        position (m, (3,)): position in ENU
        attitude_wxyz ((4,)): quaternion (w, x, y, z) of the rotation from FLU to ENU
        velocity_flu (m/s, (3,)): velocity in the body frame
        rate_flu (rad/s, (3,)): angular rate in the body frame
    """

    position: NDArray
    attitude_wxyz: NDArray
    velocity_flu: NDArray
    rate_flu: NDArray

    @property
    def yaw(self) -> float:
        """Heading, rad, counter-clockwise from east."""
        return yaw_of([float(part) for part in self.attitude_wxyz])


def pose_from_px4(position_ned: Floats, attitude: Floats, velocity: Floats, rate_frd: Floats,
                  pose_frame: int = POSE_FRAME_NED, velocity_frame: int = VELOCITY_FRAME_NED) -> Pose:
    """Pose in ROS frames. Unknown values (NaN) become 0, except in the attitude.

    Raises ValueError for a quaternion that is not of norm 1, a frame that is not NED, or a number beyond LARGEST.

    Parameters:
        position_ned (m, (3,)): position in NED
        attitude ((4,)): quaternion (w, x, y, z) of the rotation from FRD to NED
        velocity (m/s, (3,)): velocity in the frame given by `velocity_frame`
        rate_frd (rad/s, (3,)): angular rate in the body frame
        pose_frame: VehicleOdometry's constant of the frame of position and attitude
        velocity_frame: VehicleOdometry's constant of the frame of the velocity; an unknown frame gives 0 m/s
    """
    if pose_frame != POSE_FRAME_NED:
        raise ValueError(f'pose_frame is {pose_frame}, expected {POSE_FRAME_NED} (NED)')
    enu = attitude_ned_to_enu(checked_orientation(attitude, 'attitude'))
    numbers = np.nan_to_num(np.array([position_ned, velocity, rate_frd], float))
    if np.abs(numbers).max() > LARGEST:
        raise ValueError(f'a pose of {np.abs(numbers).max():.3g} m, m/s or rad/s, expected at most {LARGEST:g}')
    position, velocity, rate = numbers
    velocity_flu = (quat2mat(enu).T @ ned_to_enu(velocity) if velocity_frame == VELOCITY_FRAME_NED
                    else frd_to_flu(velocity) if velocity_frame == VELOCITY_FRAME_BODY_FRD else np.zeros(3))
    return Pose(ned_to_enu(position), enu, velocity_flu, frd_to_flu(rate))
