"""The frames of a rig's description, and the orientation of its gimbal, as messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Transform, TransformStamped
from numpy.typing import NDArray
from std_msgs.msg import Header
from transforms3d.quaternions import mat2quat

from av_common.frames import BASE_FRAME, FLU_TO_OPTICAL
from av_common.pose_messages import quaternion_message, vector_message
from av_common.rig import ArrayMount, CameraMount, GimbalMount, Rig
from av_common.stamps import to_stamp
from av_interfaces.msg import GimbalState


def static_transforms(rig: Rig, stamp: Time) -> list[TransformStamped]:
    """The transforms from the body to array and cameras, and from each camera to its optical frame.

    A camera on a gimbal stands on the gimbal's frame, which moves on the body: see `gimbal_transform`.

    Parameters:
        rig: the description.
        stamp: stamp of all transforms.
    """
    carrier, cameras = rig.gimbal.frame if rig.gimbal else BASE_FRAME, rig.cameras.values()
    carried: list[tuple[str, ArrayMount | CameraMount]] = [(BASE_FRAME, rig.array), *((carrier, one) for one in cameras)]
    mounted = [_transform(stamp, parent, part.frame, part.mount.position, part.mount.rotation) for parent, part in carried]
    return mounted + [_transform(stamp, camera.frame, camera.optical_frame, (0.0, 0.0, 0.0), FLU_TO_OPTICAL.T)
                      for camera in cameras]


def gimbal_transform(gimbal: GimbalMount, state: GimbalState) -> TransformStamped:
    """The transform from the body to the gimbal's frame, which has turned on its mount.

    Parameters:
        gimbal: its description.
        state: its orientation.
    """
    return TransformStamped(
        header=Header(stamp=state.header.stamp, frame_id=BASE_FRAME), child_frame_id=gimbal.frame,
        transform=Transform(translation=vector_message(gimbal.mount.position), rotation=state.orientation))


def gimbal_message(frame: str, time: float, attitude_wxyz: Iterable[float], variance: float, measured: bool) -> GimbalState:
    """The orientation of a gimbal.

    Parameters:
        frame: of the gimbal.
        time (s): time of the orientation.
        attitude_wxyz (4,): quaternion of the rotation from the gimbal's frame to the body.
        variance (rad^2): of the error about each axis.
        measured: whether the gimbal reported it.
    """
    return GimbalState(header=Header(stamp=to_stamp(time), frame_id=BASE_FRAME), child_frame_id=frame,
                       orientation=quaternion_message(attitude_wxyz), variance=variance,
                       source=GimbalState.SOURCE_FEEDBACK if measured else GimbalState.SOURCE_MODEL)


def _transform(stamp: Time, parent: str, child: str, position: Sequence[float], rotation: NDArray) -> TransformStamped:
    return TransformStamped(
        header=Header(stamp=stamp, frame_id=parent), child_frame_id=child,
        transform=Transform(translation=vector_message(position), rotation=quaternion_message(mat2quat(rotation))))
