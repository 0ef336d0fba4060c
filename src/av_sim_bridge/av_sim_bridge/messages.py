"""Conversion between the data that simulators send and the messages of the rig's topics."""

from __future__ import annotations

import cv2
import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import Imu
from std_msgs.msg import Header
from transforms3d.quaternions import quat2mat
from vision_msgs.msg import Detection2DArray

from av_common import pose_messages
from av_common.frames import attitude_of, checked_orientation
from av_common.stamps import to_seconds, to_stamp
from av_common.track import DRONE
from av_sim_bridge.vehicle import VehicleState
from av_sim_bridge.wire.error import FARTHEST_M, check_within
from av_sim_bridge.wire.oracle import OracleBox
from av_vision.detections import Detections
from av_vision.image import decode_image
from av_vision.messages import detections_message


def odometry_message(header: Header, child_frame: str, state: VehicleState) -> Odometry:
    """The Odometry message of a state.

    Parameters:
        header: stamp, and the frame of the pose (ENU)
        child_frame: frame of the vehicle's body (FLU), to which the twist refers
        state: state in ENU and FLU
    """
    return pose_messages.odometry_message(header, child_frame, state.position, state.attitude_wxyz,
                                          state.rotation.T @ state.velocity, state.rate_flu)


def vehicle_state(message: Odometry) -> VehicleState:
    """The state in an Odometry message (ENU and FLU). Raises ValueError for impossible values or an invalid quaternion."""
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    attitude = np.array(checked_orientation(attitude_of(orientation), 'odometry: attitude'))
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    values = np.array([position.x, position.y, position.z, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
    check_within(values, FARTHEST_M, 'odometry: value')
    return VehicleState(to_seconds(message.header.stamp), values[:3], quat2mat(attitude) @ values[3:6],
                        attitude_wxyz=attitude, rate_flu=values[6:])


def imu_message(header: Header, acceleration_flu: NDArray, rate_flu: NDArray) -> Imu:
    """The Imu message of a measurement without orientation (covariance -1, as the message defines).

    Parameters:
        header: stamp and body frame
        acceleration_flu (m/s^2, (3,)): specific force in the body frame
        rate_flu (rad/s, (3,)): angular rate in the body frame
    """
    message = Imu(header=header, linear_acceleration=pose_messages.vector_message(acceleration_flu),
                  angular_velocity=pose_messages.vector_message(rate_flu))
    message.orientation_covariance[0] = -1.0
    return message


def oracle_detections_message(header: Header, boxes: list[OracleBox]) -> Detection2DArray:
    """The visual oracle's boxes as detections with the id `oracle`; without boxes, an empty message.

    Parameters:
        header: capture time of the image, and the camera's optical frame
        boxes: boxes in pixels of the image
    """
    corners = np.array([(box.min_x, box.min_y, box.max_x, box.max_y) for box in boxes]).reshape(-1, 4)
    detections = Detections(corners, np.array([box.score for box in boxes]), (DRONE,) * len(boxes))
    return detections_message(header, detections, ('oracle',) * len(boxes))


def make_header(stamp: float, frame: str) -> Header:
    """A header from `stamp` (s, ROS time) and the id of a frame."""
    return Header(stamp=to_stamp(stamp), frame_id=frame)


def decode_depth(data: bytes, most_pixels: int) -> NDArray:
    """Depth (mm, (height, width), uint16), 0 where unknown (REP 118). Raises ValueError if it is not a 16-bit PNG.

    Parameters:
        data: content of the file.
        most_pixels: maximum number of pixels.
    """
    depth = decode_image(data, cv2.IMREAD_UNCHANGED, most_pixels)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise ValueError(f'depth: {depth.dtype} in {depth.ndim} dimensions, expected a PNG of 16 bit and one channel')
    return np.where(depth == 65_535, 0, depth).astype(np.uint16)
