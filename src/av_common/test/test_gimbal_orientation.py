"""Orientation of the gimbal: geometry, and the history that refuses the impossible."""

import math
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from scipy.spatial.transform import Rotation
from transforms3d.euler import euler2quat
from transforms3d.quaternions import mat2quat, quat2mat

from av_common.angles import angles_to_direction
from av_common.frames import BASE_FRAME, attitude_of
from av_common.gimbal_geometry import (
    angles_of_command,
    command_of_angles,
    gimbal_to_body,
    pan_and_tilt,
    stabilized_to_body,
)
from av_common.gimbal_history import (
    FEEDBACK_TIMEOUT_S,
    GimbalHistory,
    GimbalSample,
    NotYetKnownError,
    sample_of,
)
from av_common.rig import GimbalMount, Mount, load_rig
from av_common.rig_messages import (
    gimbal_message,
    gimbal_transform,
    static_transforms,
)
from av_interfaces.msg import GimbalState

TILTED = tuple(euler2quat(*np.radians([20.0, -15.0, 70.0]), 'sxyz'))  # of the body
RIG = load_rig(Path(__file__).resolve().parents[3] / 'config' / 'rig_gimbal.yaml')


@pytest.mark.parametrize('rpy', [(0.0, 0.0, 0.0), (0.0, 0.0, 180.0), (180.0, 10.0, -30.0)])
@pytest.mark.parametrize('stabilized', [True, False])
def test_pan_and_tilt_of_an_orientation_are_those_it_was_made_of(stabilized, rpy):
    gimbal = GimbalMount(mount=Mount(rpy_deg=rpy), stabilized=stabilized)
    body = gimbal_to_body(gimbal, 0.7, -0.4, TILTED)
    assert np.allclose(body @ body.T, np.eye(3))
    assert np.allclose(pan_and_tilt(gimbal, body, TILTED), (0.7, -0.4))


def test_a_stabilized_gimbal_looks_level_from_a_body_that_tilts():
    body = gimbal_to_body(GimbalMount(), math.radians(40.0), 0.0, TILTED)
    world = quat2mat(TILTED) @ body
    assert np.allclose(world[:, 0], angles_to_direction(math.radians(110.0), 0.0))
    assert np.allclose(world[:, 2], (0.0, 0.0, 1.0))


@pytest.mark.parametrize('stabilized', [True, False])
@pytest.mark.parametrize('level_command', [True, False])
def test_a_command_in_either_frame_turns_the_gimbal_to_its_direction(stabilized, level_command):
    gimbal = GimbalMount(mount=Mount(rpy_deg=(0.0, 0.0, 180.0)), stabilized=stabilized)
    pan, tilt = angles_of_command(gimbal, 0.5, 0.2, level_command, TILTED)
    sight = gimbal_to_body(gimbal, pan, tilt, TILTED)[:, 0]
    frame = stabilized_to_body(TILTED) if level_command else np.eye(3)
    assert np.allclose(sight, frame @ angles_to_direction(0.5, 0.2))


def test_a_command_keeps_its_whole_turns():
    assert angles_of_command(GimbalMount(), 4.0, 0.0, True)[0] == pytest.approx(4.0)


def test_the_camera_stands_on_the_gimbal():
    array, camera, _ = static_transforms(RIG, Time(sec=5))
    assert (array.header.frame_id, camera.header.frame_id) == (BASE_FRAME, RIG.gimbal.frame)
    turned = gimbal_to_body(RIG.gimbal, 0.3, 0.1)
    moving = gimbal_transform(RIG.gimbal, gimbal_message('gimbal_link', 7.5, mat2quat(turned), 0.01, True))
    assert (moving.header.frame_id, moving.child_frame_id) == (BASE_FRAME, RIG.gimbal.frame)
    assert np.allclose(quat2mat(attitude_of(moving.transform.rotation)), turned)


def sample(time, pan=0.0, measured=True, variance=1e-4):
    return GimbalSample(time, tuple(euler2quat(0.0, 0.0, pan)), variance, measured)


def test_the_orientation_is_interpolated_at_the_capture_time():
    history = GimbalHistory()
    for step in range(5):
        history.add(sample(10.0 + 0.1 * step, 0.1 * step), 10.02 + 0.1 * step)
    between = history.at(10.25)
    assert np.allclose(between.rotation, sample(0.0, 0.25).rotation)
    assert between.variance > 1e-4
    assert history.at(10.2).variance == pytest.approx(1e-4)
    assert history.at(9.0) is None
    assert history.at(10.41).time == 10.4
    with pytest.raises(NotYetKnownError):
        history.at(10.45)


def test_measured_orientations_go_before_modelled_ones_until_they_stop():
    history = GimbalHistory()
    assert history.add(sample(10.00, 0.9, measured=False), 10.0)
    assert history.add(sample(9.98, 0.0), 10.01)  # older than what the model gave ahead
    assert not history.add(sample(10.03, 0.9, measured=False), 10.03)
    assert history.newest.measured
    assert history.add(sample(10.10, 0.1, measured=False), 10.1)  # a gap
    assert history.has_feedback(10.1)
    assert history.add(sample(10.08, 0.1), 10.12)
    assert [time for time, _ in history._samples.entries] == [9.98, 10.08]
    late = 10.13 + FEEDBACK_TIMEOUT_S
    assert history.add(sample(late, 0.9, measured=False), late)
    assert not history.newest.measured
    assert not history.has_feedback(late)


@pytest.mark.parametrize(('time', 'pan', 'reason'), [
    (12.2, 0.0, 'from its arrival'), (8.0, 0.0, 'from its arrival'), (9.99, 0.0, 'before its predecessor'),
    (10.0, 0.0, 'before its predecessor'), (10.02, 2.0, 'no gimbal')])
def test_the_impossible_is_refused(time, pan, reason):
    history = GimbalHistory()
    history.add(sample(10.0), 10.01)
    with pytest.raises(ValueError, match=reason):
        history.add(sample(time, pan), 10.03)
    assert history.newest.time == 10.0


def test_a_gimbal_that_was_moved_while_it_was_silent_is_believed():
    history = GimbalHistory()
    history.add(sample(10.0), 10.0)
    assert history.add(sample(11.0, 2.0), 11.0)


def test_a_restarted_clock_begins_anew():
    history = GimbalHistory()
    history.add(sample(1000.0), 1000.0)
    assert history.add(sample(3.0, 2.0), 3.0)
    assert history.at(3.0).time == 3.0


def test_memory_is_bounded():
    history = GimbalHistory()
    for step in range(5000):
        history.add(sample(10.0 + 0.01 * step), 10.0 + 0.01 * step)
    assert len(history._samples.entries) <= 1001


@pytest.mark.parametrize(('change', 'reason'), [
    ({'w': math.nan}, 'norm'), ({'w': 2.0}, 'norm'), ({'w': 0.0}, 'norm'), ({'variance': math.nan}, 'variance'),
    ({'variance': -1.0}, 'variance'), ({'variance': math.inf}, 'variance'), ({'child': 'camera'}, 'expected from'),
    ({'frame': 'map'}, 'expected from'), ({'source': 7}, 'source')])
def test_a_message_that_cannot_be_used_is_refused(change, reason):
    message = gimbal_message('gimbal_link', 7.5, (1.0, 0.0, 0.0, 0.0), 0.01, True)
    assert sample_of(message, 'gimbal_link').measured
    message.orientation.w = change.get('w', 1.0)
    message.variance = change.get('variance', 0.01)
    message.child_frame_id = change.get('child', 'gimbal_link')
    message.header.frame_id = change.get('frame', 'base_link')
    message.source = change.get('source', GimbalState.SOURCE_MODEL)
    with pytest.raises(ValueError, match=reason):
        sample_of(message, 'gimbal_link')


@pytest.mark.parametrize('rpy', [(0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 0.0, 180.0), (180.0, 0.0, -90.0),
                                 (10.0, -20.0, 130.0)])
@pytest.mark.parametrize('stabilized', [True, False])
def test_commands_and_angles_about_a_turned_mount_are_each_others_inverse(rpy, stabilized):
    """Against rotations of scipy; pan keeps its turns, also of a gimbal that looks to the rear or is upside down."""
    mount = Rotation.from_euler('xyz', rpy, degrees=True)
    gimbal = GimbalMount(mount=Mount(rpy_deg=rpy), stabilized=stabilized, pan_limits_deg=(-300.0, 300.0))
    for pan in np.radians(np.arange(-300.0, 301.0, 20.0)):
        commanded = command_of_angles(gimbal, float(pan), 0.3)
        sight = mount.apply(Rotation.from_euler('ZY', [pan, -0.3]).apply([1.0, 0.0, 0.0]))
        assert np.allclose(Rotation.from_euler('ZY', [commanded[0], -commanded[1]]).apply([1.0, 0.0, 0.0]), sight)
        assert angles_of_command(gimbal, *commanded, stabilized) == pytest.approx((pan, 0.3))
