"""PX4's poses as the rig's odometry, and as the place of the built-in simulator's rig."""

from __future__ import annotations

import socket

from nav_msgs.msg import Odometry
from rclpy.node import Node
from transforms3d.quaternions import quat2mat

from av_common.clock import SenderClock
from av_common.qos import RESULT
from av_px4.continuity import ContinuousPose
from av_px4.frames import Pose
from av_px4.nodes.px4_messages import odometry_message
from av_sim_bridge.vehicle import VehicleState, to_truth
from av_sim_bridge.wire.truth import encode_truth


class OdometryRelay:
    """Publishes `odometry`; `simulator` is the host and port of a simulator that is told the same, if any."""

    def __init__(self, node: Node, odom_frame: str, base_frame: str, simulator: tuple[str, int] | None) -> None:
        self._node, self._frames, self._simulator = node, (odom_frame, base_frame), simulator
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM) if simulator else None
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
        self._px4_time.observe(time, self._node.get_clock().now().nanoseconds * 1e-9)
        stamp = self._px4_time.to_ros(time)
        pose = self._pose.add(time, pose, counter)
        self._publisher.publish(odometry_message(stamp, *self._frames, pose))
        if self._socket:
            state = VehicleState(stamp, pose.position, quat2mat(pose.attitude_wxyz) @ pose.velocity_flu,
                                 attitude_wxyz=pose.attitude_wxyz, rate_flu=pose.rate_flu)
            self._socket.sendto(encode_truth(to_truth(state, 1)), self._simulator)

    def close(self) -> None:
        """Close publisher and socket."""
        self._node.destroy_publisher(self._publisher)
        if self._socket:
            self._socket.close()
