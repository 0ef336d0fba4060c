"""The part of detector_node that says how far one can see."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_common.node import RigNode
from av_common.qos import PICTURE, RESULT
from av_common.stamps import to_seconds
from av_interfaces.msg import Visibility
from av_vision.image import image_from_message
from av_vision.visibility import estimate, ground_distances

# A depth picture that is older than this belongs to another scene.
FRESH_S = 0.2


class VisibilityReporter:
    """Publishes `visibility` at most `visibility_rate` times a second.

    Distances come from `camera/depth/image_raw`, or from `camera_height` over flat ground; without either only the share
    of contrast that is left in the picture is told.
    """

    def __init__(self, node: RigNode, settings: object) -> None:
        self._node, self._settings = node, settings
        self._next = -math.inf
        self._camera: PinholeCamera | None = None
        self._ground: NDArray | None = None
        self._depth: Image | None = None
        self._publisher = node.create_publisher(Visibility, 'visibility', RESULT)

    def activate(self) -> None:
        """Begin to listen for the scale."""
        self._next = -math.inf
        self._node.while_active(self._node.create_subscription, Image, 'camera/depth/image_raw', self._on_depth, PICTURE)
        if self._settings.camera_height > 0.0:
            self._node.while_active(self._node.create_subscription, CameraInfo, 'camera/camera_info', self._on_info, RESULT)

    def close(self) -> None:
        """Take the topic back."""
        self._node.destroy_publisher(self._publisher)

    def report(self, image: NDArray, header: Header) -> None:
        """Estimate and publish when it is time. Raises ValueError for a depth picture that cannot be read."""
        now, rate = to_seconds(header.stamp), self._settings.visibility_rate
        if rate <= 0.0 or self._next - 1.0 / rate <= now < self._next:  # a looped file begins anew
            return
        self._next = now + 1.0 / rate
        seen = estimate(image, self._distance(image.shape[:2], now), self._settings.visibility_distance)
        self._publisher.publish(Visibility(header=header, visibility=float(seen.share), range=float(seen.range)))

    def _distance(self, shape: tuple[int, int], now: float) -> NDArray | None:
        if self._depth is not None and abs(to_seconds(self._depth.header.stamp) - now) <= FRESH_S:
            depth = image_from_message(self._depth)
            metres = depth.astype(np.float32) * (1e-3 if depth.dtype == np.uint16 else 1.0)
            return metres if metres.shape == shape else None
        if self._ground is None and self._camera is not None:
            pitch = rotation_from_rpy(0.0, math.radians(self._settings.camera_pitch_deg), 0.0)
            self._ground = ground_distances(self._camera, self._settings.camera_height, pitch @ FLU_TO_OPTICAL.T)
        return self._ground if self._ground is not None and self._ground.shape == shape else None

    def _on_depth(self, message: Image) -> None:
        self._depth = message

    def _on_info(self, info: CameraInfo) -> None:
        if self._camera is None and info.k[0] > 0.0:
            self._camera = PinholeCamera.from_camera_info(info)
