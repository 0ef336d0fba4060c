"""The attitude that PX4's gimbal reports, as the rig's gimbal state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import quat2mat

from av_common.frames import attitude_ned_to_enu, checked_orientation, yaw_of
from av_common.gimbal_geometry import pan_and_tilt, stabilized_to_body
from av_common.rig import GimbalMount
from av_common.rig_messages import gimbal_message
from av_interfaces.msg import GimbalState
from av_px4.odometry import px4_clock

YAW_LOCK, YAW_IN_VEHICLE_FRAME, YAW_IN_EARTH_FRAME = 16, 32, 64  # MAVLink's GIMBAL_DEVICE_FLAGS
FAILED = 8 + 64 + 128 + 256  # MAVLink's GIMBAL_DEVICE_ERROR_FLAGS: encoder, software, communication, calibrating
SIGMA = math.radians(1.0)  # of the report, and of the vehicle's attitude at its time


class GimbalFeedback:
    """Converts the messages GimbalDeviceAttitudeStatus of PX4 1.17.

    MAVLink gives roll and pitch from the horizon, and yaw from north or from the vehicle's heading. The gimbal is thus turned
    against the body by the vehicle's attitude, which must be known. Only a MAVLink gimbal measures: for one on PWM or CAN
    outputs PX4 reports its own setpoint, which is where a claim begins, and no orientation of the gimbal.

    Attributes:
        reported (rad): the newest pan and tilt from the horizon and the vehicle's heading, None before the first.

    Parameters:
        frame: of the gimbal
    """

    def __init__(self, frame: str) -> None:
        self.reported: tuple[float, float] | None = None
        self._gimbal = GimbalMount(frame=frame)
        self._clock = px4_clock()

    def convert(self, message: Any, arrival: float, attitude_ned: Sequence[float] | None) -> GimbalState | None:
        """The gimbal's orientation; None for that of another gimbal, and where it is not measured, dated or turned.

        Parameters:
            message: a GimbalDeviceAttitudeStatus
            arrival (s): time of its arrival, ROS time
            attitude_ned: the vehicle's attitude (w, x, y, z) from FRD to NED, None while it is unknown

        Raises ValueError for an impossible attitude or flags, and for a gimbal that reports a failure.
        """
        checked_orientation(message.q, 'attitude')
        if message.failure_flags & FAILED:
            raise ValueError(f'the gimbal reports the failure {message.failure_flags}')
        if attitude_ned is None:
            return None
        attitude = attitude_ned_to_enu(attitude_ned).tolist()
        gimbal_in_body = stabilized_to_body(attitude) @ _levelled(message, yaw_of(attitude))
        self.reported = pan_and_tilt(self._gimbal, gimbal_in_body, attitude)
        time = self._clock.date(1e-6 * message.timestamp, arrival) if message.timestamp else None
        if time is None or not message.received_from_mavlink:
            return None
        return gimbal_message(self._gimbal.frame, time, gimbal_in_body, SIGMA**2, measured=True)


def _levelled(message: Any, yaw: float) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) from the gimbal's frame (FLU) to the level one with the body's heading `yaw` (rad, ENU)."""
    vehicle, earth = message.device_flags & YAW_IN_VEHICLE_FRAME, message.device_flags & YAW_IN_EARTH_FRAME
    if vehicle and earth:
        raise ValueError('the gimbal reports yaw in the frames of vehicle and earth at once')
    if earth or (not vehicle and message.device_flags & YAW_LOCK):
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ quat2mat(attitude_ned_to_enu(message.q))
    w, x, y, z = map(float, message.q)
    return quat2mat((w, x, -y, -z))  # FRD to FLU on either side
