"""Messages of the senses as measurements in the body frame, with the rig's frames looked up once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo
from tf2_ros import Buffer, TransformException, TransformListener
from transforms3d.quaternions import quat2mat
from vision_msgs.msg import Detection2DArray

from av_common.stamps import to_seconds
from av_fusion.measurements import Look, Sound
from av_fusion.sensor_geometry import look_in_body, sounds_in_body
from av_interfaces.msg import DoaArray
from av_vision.camera import PinholeCamera


class SensorMessages:
    """Reads directions of arrival and detections; `problem` says why something could not be used, or is empty."""

    def __init__(self, node: Node, base_frame: str, target_classes: Sequence[str] = ('drone',)) -> None:
        self.problem = ''
        self._base_frame = base_frame
        self._target_classes = frozenset(target_classes)
        self._camera: PinholeCamera | None = None
        self._rotations: dict[str, NDArray] = {}
        self._buffer = Buffer()
        self._listener = TransformListener(self._buffer, node)

    def set_camera(self, message: CameraInfo) -> None:
        """Take the intrinsics."""
        try:
            self._camera = PinholeCamera.from_camera_info(message)
        except ValueError as error:
            self.problem = f'camera/camera_info: {error}'

    def sounds(self, message: DoaArray, least_confidence: float = 0.0) -> list[Sound]:
        """The sounds of a message, strongest first; none where their frame is unknown."""
        found = [h for h in message.hypotheses if h.confidence >= least_confidence]
        rotation = self._rotation_from(message.header.frame_id) if found else None
        if rotation is None:
            return []
        return sounds_in_body(
            to_seconds(message.header.stamp), [(h.direction.x, h.direction.y, h.direction.z) for h in found],
            [h.azimuth_variance for h in found], [h.elevation_variance for h in found], [h.confidence for h in found],
            [h.ambiguity_group for h in found], rotation, message.window)

    def look(self, message: Detection2DArray, visibility: float = math.nan) -> Look | None:
        """A picture's detections of the target's classes; None where camera or frame is unknown."""
        if self._camera is None:
            self.problem = 'no camera/camera_info: detections cannot be turned into bearings'
            return None
        rotation = self._rotation_from(message.header.frame_id)
        if rotation is None:
            return None
        boxes = []
        for detection in message.detections:
            scores = [result.hypothesis.score for result in detection.results
                      if result.hypothesis.class_id in self._target_classes]
            if scores:
                box = detection.bbox
                boxes.append((box.center.position.x, box.center.position.y, box.size_x, box.size_y, max(scores)))
        table = np.array(boxes).reshape(-1, 5)
        return look_in_body(to_seconds(message.header.stamp), self._camera, table[:, :2], table[:, 2:4], table[:, 4],
                            rotation, visibility)

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
