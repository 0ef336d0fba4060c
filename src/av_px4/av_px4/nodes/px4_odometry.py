"""PX4's poses as the rig's odometry."""

from __future__ import annotations

from nav_msgs.msg import Odometry

from av_common.clock import SenderClock
from av_common.node import RigNode
from av_common.qos import RESULT
from av_px4.continuity import ContinuousPose
from av_px4.frames import Pose
from av_px4.nodes.px4_messages import odometry_message


class OdometryRelay:
    """Publishes the topic `odometry`, in a frame that never jumps."""

    def __init__(self, node: RigNode, odom_frame: str, base_frame: str) -> None:
        self._node, self._frames = node, (odom_frame, base_frame)
        self._pose, self._px4_time = ContinuousPose(), SenderClock()
        self._publisher = node.create_publisher(Odometry, 'odometry', RESULT)

    @property
    def resets(self) -> int:
        """How often PX4's estimator corrected itself."""
        return self._pose.resets

    def take(self, microseconds: int, pose: Pose, counter: int) -> None:
        """A pose at PX4's time, with its count of resets.

        PX4's clock is another one, and lags when it is synchronised: a sample is as old as the quickest ones tell.
        """
        time = 1e-6 * microseconds
        stamp = self._px4_time.date(time, self._node.now())
        if stamp is None:  # PX4 was synchronised or started again: half a second later its clock is followed again
            return
        pose = self._pose.add(time, pose, counter)
        self._publisher.publish(odometry_message(stamp, *self._frames, pose))

    def close(self) -> None:
        """Close the publisher."""
        self._node.destroy_publisher(self._publisher)
