"""Rotations of sensor frames from tf."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time
from tf2_ros import Buffer, TransformException
from transforms3d.quaternions import quat2mat

from av_common.frames import BASE_FRAME, attitude_of
from av_common.gimbal_history import NEAREST_S, NotYetKnownError
from av_common.tf_listener import GuardedTransformListener

LATEST_S = 1.0  # how long before a capture time the newest transform may be for its successor to be waited for


class TfRotations:
    """Looks up how sensor frames are rotated on the rig's body, at the time of a measurement: they may move.

    Attributes:
        problem: why the newest look-up failed, empty when it did not.

    Parameters:
        node: subscribes to tf.
        nearest (s): how long after the newest transform that one is taken.
        namespace: see `GuardedTransformListener`.
    """

    def __init__(self, node: Node, nearest: float = NEAREST_S, namespace: str = '') -> None:
        self.problem = ''
        self._nearest = nearest
        self._buffer = Buffer()
        self._topic = node.resolve_topic_name(f'{namespace}tf_static')
        self._listener = GuardedTransformListener(self._buffer, node, namespace)
        self._fixed: dict[str, NDArray[np.float64]] = {}  # rotations of frames that do not move
        self._version = 0  # of the fixed frames when these were looked up

    def rotation(self, frame: str, time: float) -> NDArray[np.float64] | None:
        """Rotation matrix (3, 3) from a sensor frame to the body frame at `time` (s), interpolated; None if unknown.

        The newest transform is taken for a time that is up to `nearest` later. Raises NotYetKnownError where a transform of
        that time may still come.
        """
        self.problem = ''
        if self._version != self._listener.version:
            self._version = self._listener.version
            self._fixed.clear()
        if frame in self._fixed:
            return self._fixed[frame]
        try:
            newest = 1e-9 * self._buffer.get_latest_common_time(BASE_FRAME, frame).nanoseconds  # 0 for fixed frames
            late = time - newest if newest else 0.0
            if self._nearest < late <= LATEST_S:
                raise NotYetKnownError(f'no transform from {frame!r} to {BASE_FRAME!r} of the capture time yet')
            at = newest if 0.0 < late <= self._nearest else time
            found = self._buffer.lookup_transform(BASE_FRAME, frame, Time(nanoseconds=round(1e9 * at)))
        except TransformException as error:
            self.problem = f'no transform from {frame!r} to {BASE_FRAME!r} on {self._topic}: {error}'
            return None
        rotation: NDArray[np.float64] = quat2mat(attitude_of(found.transform.rotation))
        if not newest:
            rotation.flags.writeable = False
            self._fixed[frame] = rotation
        return rotation
