"""Messages of the rig's topics made of what simulators send, and back."""

from __future__ import annotations

import array

import cv2
import numpy as np
from geometry_msgs.msg import Quaternion, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import Imu
from std_msgs.msg import Header
from transforms3d.quaternions import quat2mat
from vision_msgs.msg import Detection2DArray

from av_common.frames import attitude_of
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import AudioFrame
from av_sim_bridge.vehicle import VehicleState
from av_sim_bridge.wire.oracle import OracleBox
from av_vision.detections import Detections
from av_vision.messages import detections_message


def audio_message(header: Header, sample_rate: int, first_sample: int, samples: NDArray) -> AudioFrame:
    """Samples (n, channels) float32."""
    message = AudioFrame(header=header, sample_rate=sample_rate, channels=samples.shape[1], first_sample=first_sample)
    message.samples = array.array('f', np.ascontiguousarray(samples, np.float32).tobytes())
    return message


def odometry_message(header: Header, child_frame: str, state: VehicleState) -> Odometry:
    """A state; the twist is in the child's frame, as the message defines."""
    message = Odometry(header=header, child_frame_id=child_frame)
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = map(float, state.position)
    pose.orientation = _quaternion(state.attitude_wxyz)
    twist.linear = _vector(state.rotation.T @ state.velocity)
    twist.angular = _vector(state.rate_flu)
    return message


def vehicle_state(message: Odometry) -> VehicleState:
    """The state that an Odometry in ENU and FLU describes. Raises ValueError for a pose that is not finite or not a pose."""
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    attitude = np.array(attitude_of(orientation))
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    values = np.array([position.x, position.y, position.z, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
    norm = float(np.linalg.norm(attitude))
    if not (np.isfinite(values).all() and abs(norm - 1.0) < 0.05):
        raise ValueError(f'odometry: numbers that are not finite, or a quaternion of norm {norm:.3g} where 1 is expected')
    attitude /= norm
    return VehicleState(to_seconds(message.header.stamp), values[:3], quat2mat(attitude) @ values[3:6],
                        attitude_wxyz=attitude, rate_flu=values[6:])


def imu_message(header: Header, acceleration_flu: NDArray, rate_flu: NDArray) -> Imu:
    """An inertial measurement without orientation (covariance -1, as the message defines)."""
    message = Imu(header=header, linear_acceleration=_vector(acceleration_flu), angular_velocity=_vector(rate_flu))
    message.orientation_covariance[0] = -1.0
    return message


def oracle_detections_message(header: Header, boxes: list[OracleBox]) -> Detection2DArray:
    """The oracle's boxes, marked as the oracle's; empty when nothing was seen."""
    corners = np.array([(box.min_x, box.min_y, box.max_x, box.max_y) for box in boxes]).reshape(-1, 4)
    detections = Detections(corners, np.array([box.score for box in boxes]), ('drone',) * len(boxes))
    return detections_message(header, detections, ('oracle',) * len(boxes))


def make_header(stamp: float, frame: str) -> Header:
    """A header of a ROS time in s."""
    return Header(stamp=to_stamp(stamp), frame_id=frame)


def decode_image(data: bytes, flags: int = cv2.IMREAD_COLOR) -> NDArray:
    """An image (height, width, 3) uint8, BGR. Raises ValueError for what is neither JPEG nor PNG."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ValueError(f'image: {error.err}') from error
    if image is None:
        raise ValueError('image: neither JPEG nor PNG')
    return image


def decode_depth(data: bytes) -> NDArray:
    """Depth (height, width) uint16 in mm, 0 where there is none (REP 118). Raises ValueError for what is no depth."""
    depth = decode_image(data, cv2.IMREAD_UNCHANGED)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise ValueError(f'depth: {depth.dtype} in {depth.ndim} dimensions, a PNG of 16 bit and one channel expected')
    return np.where(depth == 65_535, 0, depth).astype(np.uint16)


def _vector(values: NDArray) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def _quaternion(wxyz: NDArray) -> Quaternion:
    w, x, y, z = map(float, wxyz)
    return Quaternion(w=w, x=x, y=y, z=z)
