"""The frames of the rig as tf has them."""

from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from transforms3d.quaternions import quat2mat

from av_common.frames import BASE_FRAME, attitude_of
from av_common.rig import Rig, load_rig
from av_common.rig_messages import static_transforms


def test_two_cameras_have_frames_of_their_own():
    rig = load_rig(Path(__file__).resolve().parents[3] / 'config' / 'rig_two_cameras.yaml')
    parents = {frame.child_frame_id: frame.header.frame_id for frame in static_transforms(rig, Time())}
    assert {parents[camera.frame] for camera in rig.cameras.values()} == {BASE_FRAME}
    assert [parents[camera.optical_frame] for camera in rig.cameras.values()] == [rig.camera.frame, rig.second_camera.frame]
    with pytest.raises(ValueError, match='names that differ'):
        Rig(rig.array, rig.camera, rig.camera)


def test_frames_of_the_shipped_rig():
    rig = load_rig(Path(__file__).resolve().parents[3] / 'config' / 'rig.yaml')
    array, camera, optical = static_transforms(rig, Time(sec=5))
    assert [frame.child_frame_id for frame in (array, camera, optical)] == [
        rig.array.frame, rig.camera.frame, rig.camera.optical_frame]
    assert (array.header.frame_id, optical.header.frame_id, array.header.stamp.sec) == (BASE_FRAME, rig.camera.frame, 5)
    place = camera.transform.translation
    assert (place.x, place.y, place.z) == tuple(rig.camera.mount.position)
    steps = [quat2mat(attitude_of(frame.transform.rotation)) for frame in (camera, optical)]
    assert np.allclose(steps[0] @ steps[1], rig.camera.optical_to_body)
