"""The rig's static frames, from the description of the rig to /tf_static."""

from __future__ import annotations

from geometry_msgs.msg import TransformStamped
from tf2_ros import StaticTransformBroadcaster
from transforms3d.quaternions import mat2quat

from av_common.frames import FLU_TO_OPTICAL
from av_common.node import RigNode, run
from av_common.rig import load_rig
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
        mounted = [(rig.base_frame, part.frame, part.mount.position, part.mount.rotation) for part in (rig.array, rig.camera)]
        optical = (rig.camera.frame, rig.camera.optical_frame, (0.0, 0.0, 0.0), FLU_TO_OPTICAL.T)
        self._broadcaster.sendTransform([self._transform(*frame) for frame in (*mounted, optical)])

    def _transform(self, parent: str, child: str, position: tuple, rotation: list) -> TransformStamped:
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id = parent
        transform.header.stamp = self.get_clock().now().to_msg()
        translation, quaternion = transform.transform.translation, transform.transform.rotation
        translation.x, translation.y, translation.z = map(float, position)
        quaternion.w, quaternion.x, quaternion.y, quaternion.z = map(float, mat2quat(rotation))
        return transform


def main() -> None:
    """Run the node."""
    run(RigFramesNode)
