"""The frames of a rig's description as messages of tf."""

from __future__ import annotations

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from numpy.typing import NDArray
from std_msgs.msg import Header
from transforms3d.quaternions import mat2quat

from av_common.frames import FLU_TO_OPTICAL
from av_common.rig import Rig


def static_transforms(rig: Rig, stamp: Time) -> list[TransformStamped]:
    """The transforms from the body to array and camera, and from the camera to its optical frame.

    Parameters:
        rig: the description.
        stamp: stamp of all transforms.
    """
    mounted = [_transform(stamp, rig.base_frame, part.frame, part.mount.position, part.mount.rotation)
               for part in (rig.array, rig.camera)]
    return [*mounted, _transform(stamp, rig.camera.frame, rig.camera.optical_frame, (0.0, 0.0, 0.0), FLU_TO_OPTICAL.T)]


def _transform(stamp: Time, parent: str, child: str, position: Sequence[float], rotation: NDArray) -> TransformStamped:
    x, y, z = map(float, position)
    turn = dict(zip('wxyz', map(float, mat2quat(rotation)), strict=True))
    return TransformStamped(header=Header(stamp=stamp, frame_id=parent), child_frame_id=child,
                            transform=Transform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(**turn)))
