"""Rotations of sensor frames from tf."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time
from tf2_ros import Buffer, TransformException, TransformListener
from transforms3d.quaternions import quat2mat

from av_common.frames import attitude_of


class TfRotations:
    """Looks up how sensor frames are rotated on the rig's body.

    Attributes:
        problem: why the newest look-up failed, empty when it did not.

    Parameters:
        node: subscribes to tf.
        base_frame: the body frame.
    """

    def __init__(self, node: Node, base_frame: str) -> None:
        self.problem = ''
        self._base_frame = base_frame
        self._rotations: dict[str, NDArray[np.float64]] = {}
        self._buffer = Buffer()
        self._listener = TransformListener(self._buffer, node)

    def rotation(self, frame: str, time: float) -> NDArray[np.float64] | None:
        """Rotation matrix (3, 3) from a sensor frame to the body frame at `time` (s), None if unknown.

        Sensors are fixed to the body, so that each frame is looked up once.
        """
        if frame not in self._rotations:
            try:
                q = self._buffer.lookup_transform(self._base_frame, frame, Time()).transform.rotation
            except TransformException as error:
                self.problem = f'no transform from {frame!r} to {self._base_frame!r}: {error}'
                return None
            self._rotations[frame] = quat2mat(attitude_of(q))
            self.problem = ''
        return self._rotations[frame]
