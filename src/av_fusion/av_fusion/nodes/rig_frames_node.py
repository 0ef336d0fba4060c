"""The rig's static frames, from the description of the rig to /tf_static."""

from __future__ import annotations

from tf2_ros import StaticTransformBroadcaster

from av_common.node import RigNode, run
from av_common.rig import load_rig
from av_common.rig_messages import static_transforms
from av_fusion.nodes.rig_frames_node_parameters import rig_frames_node as parameters


class RigFramesNode(RigNode):
    """Publishes where array and camera sit on the body; for rigs whose description is no URDF."""

    def __init__(self) -> None:
        super().__init__('rig_frames_node', parameters)

    def configure(self) -> None:
        """Read the rig and publish its frames, latched."""
        if not self.settings.rig_file:
            raise ValueError("rig_file is empty, expected the path of the rig's description such as config/rig.yaml")
        rig = load_rig(self.settings.rig_file)
        self._broadcaster = StaticTransformBroadcaster(self)
        self._broadcaster.sendTransform(static_transforms(rig, self.get_clock().now().to_msg()))


def main() -> None:
    """Run the node."""
    run(RigFramesNode)
