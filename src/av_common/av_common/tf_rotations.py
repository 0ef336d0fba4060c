"""Rotations of sensor frames by the tf of a rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from av_common.frame_tree import FrameTree
from av_common.frames import BASE_FRAME
from av_common.gimbal_history import NEAREST_S
from av_common.qos import FRAMES

MOVING_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100)  # as of tf2_ros


class TfRotations:
    """Looks up how sensor frames are rotated on the rig's body, at the time of a measurement: they may move.

    The topics are relative, where tf2_ros has /tf and /tf_static: the frames of two rigs have the same names. What the
    `FrameTree` refuses is raised as ValueError once the rest of a message is taken, for the guard of the node's subscriptions
    to count.

    Attributes:
        problem: why the newest look-up failed, empty when it did not.

    Parameters:
        node: subscribes to tf.
        nearest (s): how long after the newest transform that one is taken.
        namespace: of the rig, such as '/left/'; empty for that of the node.
    """

    def __init__(self, node: Node, nearest: float = NEAREST_S, namespace: str = '') -> None:
        self.problem = ''
        self._tree, self._nearest, self._clock = FrameTree(), nearest, node.get_clock()
        self._topic = node.resolve_topic_name(f'{namespace}tf_static')
        node.create_subscription(TFMessage, f'{namespace}tf', self.on_moving, MOVING_QOS)
        node.create_subscription(TFMessage, f'{namespace}tf_static', self.on_fixed, FRAMES)

    def on_moving(self, message: TFMessage) -> None:
        """Take moving frames. Raises ValueError for those that are refused."""
        _raise(self._tree.learn(message.transforms, 1e-9 * self._clock.now().nanoseconds))

    def on_fixed(self, message: TFMessage) -> None:
        """Take fixed frames. Raises ValueError for those that are refused."""
        _raise(self._tree.learn(message.transforms))

    def rotation(self, frame: str, time: float) -> NDArray[np.float64] | None:
        """Rotation matrix (3, 3) from a sensor frame to the body frame at `time` (s), interpolated; None if unknown.

        Raises NotYetKnownError where a transform of that time may still come.
        """
        self.problem = ''
        rotation = self._tree.rotation(frame, time, self._nearest)
        if rotation is None:
            self.problem = f'no transform from {frame!r} to {BASE_FRAME!r} on {self._topic}'
        return rotation


def _raise(refused: dict[str, str]) -> None:
    if refused:
        raise ValueError('; '.join(f'{frame[:50]!r}: {why}' for frame, why in list(refused.items())[:5]))
