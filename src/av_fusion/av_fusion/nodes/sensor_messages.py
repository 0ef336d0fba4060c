"""Messages of the senses as measurements in the body frame, with the rig's frames looked up once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo
from tf2_ros import Buffer, TransformException, TransformListener
from transforms3d.quaternions import quat2mat

from av_common.camera import PinholeCamera
from av_fusion.measurement.converter import Senses
from av_fusion.measurement.measurements import Look


class SensorMessages(Senses):
    """Takes rotations from tf and the camera from its CameraInfo; `problem` says why something is unused, or is empty."""

    def __init__(self, node: Node, base_frame: str, target_classes: Sequence[str] = ('drone',)) -> None:
        super().__init__(self._rotation_from, target_classes, camera=None)
        self.problem = ''
        self._base_frame = base_frame
        self._intrinsics: CameraInfo | None = None
        self._rotations: dict[str, NDArray] = {}
        self._buffer = Buffer()
        self._listener = TransformListener(self._buffer, node)

    def set_camera(self, message: CameraInfo) -> None:
        """Take the intrinsics; they come with every picture."""
        message.header.stamp = Time().to_msg()
        if message == self._intrinsics:
            return
        try:
            self.camera = PinholeCamera.from_camera_info(message)
            self._intrinsics = message
        except ValueError as error:
            self.problem = f'camera/camera_info: {error}'

    def look(self, message: Any, visibility: float = math.nan) -> Look | None:
        """As `Senses.look`, with a word on a camera that is missing."""
        if self.camera is None:
            self.problem = 'no camera/camera_info: detections cannot be turned into bearings'
        return super().look(message, visibility)

    def _rotation_from(self, frame: str) -> NDArray | None:
        """Rotation (3, 3) from a sensor's frame into the body's; sensors are fixed, so one look-up serves."""
        if frame not in self._rotations:
            try:
                q = self._buffer.lookup_transform(self._base_frame, frame, Time()).transform.rotation
            except TransformException as error:
                self.problem = f'no transform from {frame!r} to {self._base_frame!r}: {error}'
                return None
            self._rotations[frame] = quat2mat([q.w, q.x, q.y, q.z])
            self.problem = ''
        return self._rotations[frame]
