"""A listener to tf that nothing received can spoil for good: the buffer of tf2 forgets neither frames nor stamps."""

from __future__ import annotations

import math

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from tf2_msgs.msg import TFMessage
from tf2_ros import Buffer

from av_common.freshness import FUTURE_S
from av_common.stamps import to_seconds

NORM_TOLERANCE = 4e-3  # of the length of a quaternion, slightly less than that of tf2
MOST_FRAMES = 500  # of all robots on one tf
MOVING_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100)  # as of tf2_ros
FIXED_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STEP_S = 1.0  # a larger step back of the node's clock, as where a bag begins again, empties the buffer


class GuardedTransformListener:
    """Adds the transforms of tf and tf_static to a buffer, and refuses those after which it would not find others.

    The topics are relative, where tf2_ros has /tf and /tf_static: the frames of two rigs have the same names. Refused are an
    ancestor that becomes a child of its descendant; a stamp of the future, after which tf2 takes no earlier one; a frame that
    was fixed and now moves; and frames without number. What is refused is raised as ValueError once the rest of the message is
    added, for the guard of the node's subscriptions to count.

    Attributes:
        version: number of messages with fixed frames, which change only by these.

    Parameters:
        buffer: gets the transforms.
        node: subscribes.
        namespace: of the rig, such as '/left/'; empty for that of the node.
    """

    def __init__(self, buffer: Buffer, node: Node, namespace: str = '') -> None:
        self._parents: dict[str, str] = {}
        self._fixed: set[str] = set()
        self.version = 0
        self._clock, self._now = node.get_clock(), -math.inf
        self._buffer = buffer
        node.create_subscription(TFMessage, f'{namespace}tf', self.callback, MOVING_QOS)
        node.create_subscription(TFMessage, f'{namespace}tf_static', self.static_callback, FIXED_QOS)

    def callback(self, data: TFMessage) -> None:
        """Take moving frames."""
        now = 1e-9 * self._clock.now().nanoseconds
        if now < self._now - STEP_S:
            self._buffer.clear()
        self._now = now
        self._take(data, fixed=False)

    def static_callback(self, data: TFMessage) -> None:
        """Take fixed frames."""
        self.version += 1
        self._take(data, fixed=True)

    def _take(self, data: TFMessage, fixed: bool) -> None:
        refused = ''
        for transform in data.transforms:
            problem = self._problem(transform, fixed)
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
        if not abs(math.hypot(turn.x, turn.y, turn.z, turn.w) - 1.0) < NORM_TOLERANCE:
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
