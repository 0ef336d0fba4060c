"""The rig's frames: those that are fixed from its description to tf_static, that of its gimbal to tf."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from av_common.node import RigNode, run
from av_common.qos import LATCHED, RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.rig import load_rig
from av_common.rig_messages import static_transforms
from av_interfaces.msg import GimbalState, PointingCommand
from av_pointing.gimbal_stage import GimbalStage
from av_pointing.nodes.rig_frames_node_parameters import rig_frames_node as parameters

PERIOD_S = 0.05  # of the model's orientations where no odometry comes
REPEAT_S = 0.5  # of the fixed frames, which another publisher may have moved


class RigFramesNode(RigNode):
    """Publishes where array, gimbal and camera sit on the body; for rigs whose description is no URDF.

    Runs a `GimbalStage` where the rig has a gimbal.
    """

    def __init__(self) -> None:
        super().__init__('rig_frames_node', parameters)

    def configure(self) -> None:
        """Read the rig and publish its fixed frames, latched."""
        if not self.settings.rig_file:
            raise ValueError("rig_file is empty, expected the path of the rig's description such as config/rig.yaml")
        rig = load_rig(self.settings.rig_file)
        # Relative names, not those of tf2_ros's broadcasters: rigs in namespaces have frames of the same names.
        self._fixed = self.create_publisher(TFMessage, 'tf_static', LATCHED)
        self._frames = TFMessage(transforms=static_transforms(rig, self.get_clock().now().to_msg()))
        self._fixed.publish(self._frames)
        joints, model = self.settings.joints, self.settings.model
        self._stage = GimbalStage(rig, (joints.pan, joints.tilt, joints.roll), math.radians(joints.sigma_deg),
                                  model) if rig.gimbal else None
        if self._stage:
            self._meter = RateMeter()
            self._moving = self.create_publisher(TFMessage, 'tf', RESULT)
            self._publisher = self.create_publisher(GimbalState, 'gimbal/state', STREAM)

    def activate(self) -> None:
        """Repeat the fixed frames, and subscribe to what tells where the gimbal points."""
        self.create_timer(REPEAT_S, self._send_fixed)
        if self._stage is None:
            return
        self.create_subscription(GimbalState, 'gimbal/state', self._on_state, STREAM)
        self.create_subscription(PointingCommand, 'pointing/command', self._on_command, RESULT)
        self.create_subscription(JointState, 'joint_states', partial(self._publish, self._stage.on_joints), STREAM)
        self.subscribe_odometry(self._on_odometry)
        self.refuse_second_publishers('pointing/command', 'odometry')
        self.create_timer(PERIOD_S, self._on_time)

    def _send_fixed(self) -> None:
        self._fixed.publish(self._frames)

    def _on_state(self, message: GimbalState) -> None:
        transform = self._stage.on_state(message, self.now()) if self._stage else None
        if transform is not None:
            self._meter.tick()
            self._moving.publish(TFMessage(transforms=[transform]))

    def _on_command(self, message: PointingCommand) -> None:
        if self._stage and 'pointing/command' not in self.contested:    # which no gimbal obeys then
            self._stage.on_command(message, self.now())

    def _on_odometry(self, message: Odometry) -> None:
        if self._stage and 'odometry' not in self.contested:
            self._publish(self._stage.on_odometry, message)

    def _publish(self, take: Any, message: Any) -> None:
        state = take(message, self.now())
        if state is not None:
            self._publisher.publish(state)

    def _on_time(self) -> None:
        state = self._stage.on_time(self.now()) if self._stage else None
        if state is not None:
            self._publisher.publish(state)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Where the gimbal's orientation comes from."""
        if self._stage is None:
            return
        problem = self._stage.problem(self.now())
        if problem:
            status.mergeSummary(DiagnosticStatus.WARN, problem)
        status.add('gimbal', self._stage.source(self.now()))
        status.add('gimbal rate (Hz)', f'{self._meter.rate:.1f}')


def main() -> None:
    """Run the node."""
    run(RigFramesNode)
