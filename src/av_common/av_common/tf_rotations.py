"""Rotations of sensor frames from tf, by a listener that nothing received can spoil for good.

The buffer of tf2 forgets neither frames nor stamps.
"""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.time import Time
from tf2_msgs.msg import TFMessage
from tf2_ros import Buffer, TransformException
from transforms3d.quaternions import quat2mat

from av_common.body_odometry import MOST_FRAMES
from av_common.frames import BASE_FRAME, attitude_of, is_orientation
from av_common.freshness import FUTURE_S
from av_common.gimbal_history import NEAREST_S, OLDEST_S, RESTART_S, NotYetKnownError
from av_common.qos import FRAMES
from av_common.stamps import to_seconds

MOVING_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100)  # as of tf2_ros


class TfRotations:
    """Looks up how sensor frames are rotated on the rig's body, at the time of a measurement: they may move.

    The topics are relative, where tf2_ros has /tf and /tf_static: the frames of two rigs have the same names. Transforms after
    which the buffer would not find others are refused: an ancestor that becomes a child of its descendant; a stamp of the
    future, after which tf2 takes no earlier one; a frame that was fixed and now moves; and frames without number. What is
    refused is raised as ValueError once the rest of the message is added, for the guard of the node's subscriptions to count.

    Attributes:
        problem: why the newest look-up failed, empty when it did not.

    Parameters:
        node: subscribes to tf.
        nearest (s): how long after the newest transform that one is taken.
        namespace: of the rig, such as '/left/'; empty for that of the node.
    """

    def __init__(self, node: Node, nearest: float = NEAREST_S, namespace: str = '') -> None:
        self.problem = ''
        self._nearest, self._buffer = nearest, Buffer()
        self._parents: dict[str, str] = {}
        self._fixed: set[str] = set()
        self._clock, self._now = node.get_clock(), -math.inf
        self._topic = node.resolve_topic_name(f'{namespace}tf_static')
        node.create_subscription(TFMessage, f'{namespace}tf', self.callback, MOVING_QOS)
        node.create_subscription(TFMessage, f'{namespace}tf_static', self.static_callback, FRAMES)

    def rotation(self, frame: str, time: float) -> NDArray[np.float64] | None:
        """Rotation matrix (3, 3) from a sensor frame to the body frame at `time` (s), interpolated; None if unknown.

        The newest transform is taken for a time that is up to `nearest` later. Raises NotYetKnownError where a transform of
        that time may still come.
        """
        self.problem = ''
        try:
            newest = 1e-9 * self._buffer.get_latest_common_time(BASE_FRAME, frame).nanoseconds  # 0 for fixed frames
            late = time - newest if newest else 0.0
            if self._nearest < late <= OLDEST_S:
                raise NotYetKnownError(f'no transform from {frame!r} to {BASE_FRAME!r} of the capture time yet')
            at = newest if 0.0 < late <= self._nearest else time
            found = self._buffer.lookup_transform(BASE_FRAME, frame, Time(nanoseconds=round(1e9 * at)))
        except TransformException as error:
            self.problem = f'no transform from {frame!r} to {BASE_FRAME!r} on {self._topic}: {error}'
            return None
        return np.asarray(quat2mat(attitude_of(found.transform.rotation)))

    def callback(self, data: TFMessage) -> None:
        """Take moving frames."""
        now = 1e-9 * self._clock.now().nanoseconds
        if now < self._now - RESTART_S:  # as where a bag begins again
            self._buffer.clear()
        self._now = now
        self._take(data, fixed=False)

    def static_callback(self, data: TFMessage) -> None:
        """Take fixed frames."""
        self._take(data, fixed=True)

    def _take(self, data: TFMessage, fixed: bool) -> None:
        refused = ''
        for transform in data.transforms:
            try:
                problem = self._problem(transform, fixed)
            except ValueError as error:    # of a stamp that is none
                problem = str(error)
            if problem:
                refused = f'{transform.child_frame_id[:50]!r} in {transform.header.frame_id[:50]!r}: {problem}'
                continue
            add = self._buffer.set_transform_static if fixed else self._buffer.set_transform
            add(transform, 'default_authority')
        if refused:
            raise ValueError(refused)

    def _problem(self, transform: TransformStamped, fixed: bool) -> str:
        """Why a transform cannot be taken, '' where it can; notes its frames then."""
        move, turn = transform.transform.translation, transform.transform.rotation
        if not all(map(math.isfinite, (move.x, move.y, move.z))):
            return 'the translation is not finite'
        if not is_orientation(attitude_of(turn)):
            return 'the rotation is no unit quaternion'
        child, parent = (name.removeprefix('/') for name in (transform.child_frame_id, transform.header.frame_id))
        if not child or not parent:
            return 'a frame without name'
        if not fixed and child in self._fixed:
            return 'a fixed frame does not move'
        if not fixed and to_seconds(transform.header.stamp) > self._now + FUTURE_S:
            return 'a stamp of the future'
        if child not in self._parents and len(self._parents) >= MOST_FRAMES:
            return f'more than {MOST_FRAMES} frames'
        ancestor: str | None = parent
        while ancestor is not None:
            if ancestor == child:
                return 'a loop'
            ancestor = self._parents.get(ancestor)
        self._parents[child] = parent
        if fixed:
            self._fixed.add(child)
        return ''
