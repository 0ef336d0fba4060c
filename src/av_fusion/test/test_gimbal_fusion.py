"""A camera that moves on the body: orientation of the capture time, its error, and transforms that are late."""

import math

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Quaternion, TransformStamped
from sensor_msgs.msg import CameraInfo
from test_fusion_stage import Recorder, camera_info, detections, odometry
from transforms3d.euler import euler2quat
from vision_msgs.msg import Detection2DArray

from av_common.frames import FLU_TO_OPTICAL
from av_common.gimbal_history import GimbalHistory, NotYetKnownError
from av_common.parameters import node_parameters
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_stamp
from av_common.tf_rotations import TfRotations
from av_fusion.measurement.converter import gimbal_rotations
from av_fusion.stage import make_fusion_stage

T = 1000.0


class GimbalRig:
    """A fusion stage whose camera rides on a gimbal."""

    def __init__(self):
        self.recorder, history = Recorder(), GimbalHistory()
        rotations = gimbal_rotations({'microphones': np.eye(3)}, {'camera': FLU_TO_OPTICAL.T}, history)
        self.stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), rotations, observer=self.recorder,
                                       gimbal=history)
        self.stage.on_camera_info(camera_info())

    def turn(self, time, pan, sigma=0.0):
        message = gimbal_message_of(time, pan, sigma)
        return self.stage.on_gimbal(message, time + 0.005)

    def see(self, time, arrival):
        return self.stage.on_detections(detections(time, (319.5, 0.9, 'drone')), arrival)


def gimbal_message_of(time, pan, sigma=0.0):
    return gimbal_message('gimbal_link', time, euler2quat(0.0, 0.0, pan), sigma**2, True)


def test_a_camera_that_turns_at_120_deg_per_s_sees_where_it_looked_at_capture():
    rig = GimbalRig()
    rate = math.radians(120.0)
    for step in range(40):
        rig.turn(T + 0.02 * step, rate * 0.02 * step)
        if step % 5 == 4:
            rig.see(T + 0.02 * step - 0.033, T + 0.02 * step + 0.006)
    errors = [m.detections[0].azimuth - rate * (m.time - T) for m in rig.recorder.camera]
    assert len(errors) == 8
    assert np.abs(np.degrees(errors)).max() < 0.1
    newest = rig.recorder.camera[-1]
    assert math.atan2(newest.view[1][0], newest.view[0][0]) == pytest.approx(newest.detections[0].azimuth, abs=1e-3)


def test_the_error_of_the_orientation_is_an_error_of_what_the_camera_sees():
    variances = []
    for sigma in (0.0, math.radians(3.0)):
        rig = GimbalRig()
        rig.turn(T, 0.4, sigma)
        rig.see(T, T + 0.01)
        found = rig.recorder.camera[0].detections[0]
        variances.append((found.across_variance, found.elevation_variance))
    assert np.allclose(np.subtract(*reversed(variances)), math.radians(3.0)**2, rtol=0.02)


def test_an_image_waits_a_moment_for_the_orientation_and_is_dropped_after_it():
    rig = GimbalRig()
    rig.turn(T, 0.0)
    assert rig.see(T + 0.06, T + 0.061) is None
    assert not rig.recorder.camera
    assert rig.turn(T + 0.08, 0.2) is not None
    assert rig.recorder.camera[0].detections[0].azimuth == pytest.approx(0.15, abs=1e-3)
    assert rig.see(T + 0.3, T + 0.3) is None
    rig.stage.on_time(T + 0.4)
    assert rig.stage.untransformed == 0
    rig.stage.on_time(T + 0.46)
    assert rig.stage.untransformed == 1
    rig.turn(T + 0.5, 0.2)
    assert len(rig.recorder.camera) == 1


def test_sound_does_not_wait_for_the_camera():
    from test_fusion_stage import doa
    rig = GimbalRig()
    rig.see(T, T)
    assert rig.stage.on_doa(doa(T, 0.3), T + 0.01) is not None


def test_hostile_orientations_raise_and_are_not_used():
    rig = GimbalRig()
    rig.turn(T, 0.0)
    bad = gimbal_message_of(T + 0.02, 0.3)
    bad.orientation.x = math.nan
    for message in (bad, gimbal_message_of(T + 5.0, 0.0), gimbal_message_of(T + 0.02, 3.0), gimbal_message_of(T - 3.0, 0.0)):
        with pytest.raises(ValueError, match='.'):
            rig.stage.on_gimbal(message, T + 0.03)
    assert rig.stage._gimbal.newest.time == T


def test_an_orientation_of_two_publishers_is_not_used():
    """It turns what the camera sees, and the body with it."""
    rig = GimbalRig()
    rig.turn(T, 0.0)
    rig.stage.refuse_contested({'gimbal/state': ['/bridge_node', '/forger']})
    assert rig.turn(T + 0.02, 1.0) is None and rig.stage._gimbal.newest.time == T
    rig.stage.refuse_contested({})
    rig.turn(T + 0.04, 0.1)
    assert rig.stage._gimbal.newest.time == T + 0.04


def test_a_rig_without_gimbal_ignores_the_topic():
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), lambda frame, time: FLU_TO_OPTICAL.T)
    assert stage.on_gimbal(gimbal_message_of(T + 99.0, 0.0), T) is None
    stage.on_camera_info(CameraInfo(width=640, height=480, k=[457.0, 0.0, 319.5, 0.0, 457.0, 239.5, 0.0, 0.0, 1.0],
                                    d=[0.0] * 5, distortion_model='plumb_bob'))
    stage.on_odometry(odometry(T, 0.0), T)
    empty = Detection2DArray()
    empty.header.stamp = to_stamp(T)
    assert stage.on_detections(empty, T) is not None


def test_a_camera_model_that_cannot_be_used_is_forgotten_when_the_usual_one_comes_again():
    converter = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), lambda frame, time: FLU_TO_OPTICAL.T).converter
    usual = CameraInfo(width=640, height=480, k=[457.0, 0.0, 319.5, 0.0, 457.0, 239.5, 0.0, 0.0, 1.0], d=[0.0] * 5,
                       distortion_model='plumb_bob')
    converter.set_camera_info(usual)
    camera = converter.cameras['camera']
    converter.set_camera_info(CameraInfo(width=640, height=480))
    assert 'not calibrated' in converter.problems['camera'] and converter.cameras['camera'] is camera
    converter.set_camera_info(usual)
    assert not converter.problems and converter.cameras['camera'] is camera


@pytest.fixture
def tf():
    rclpy.init()
    node = rclpy.create_node('tf_rotations_test')
    yield TfRotations(node)
    node.destroy_node()
    rclpy.shutdown()


def transform(child, time, yaw, parent='base_link'):
    w, x, y, z = map(float, euler2quat(0.0, 0.0, yaw))
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, to_stamp(time)
    message.transform.rotation = Quaternion(w=w, x=x, y=y, z=z)
    return message


def yaw_of(rotation):
    return math.atan2(rotation[1, 0], rotation[0, 0])


def test_tf_is_asked_for_the_capture_time_and_never_kept(tf):
    tf._buffer.set_transform_static(transform('microphones', 0.0, 0.5), 'test')
    tf._buffer.set_transform_static(transform('camera', 0.0, 0.1, 'gimbal_link'), 'test')
    assert tf.rotation('camera', T) is None
    assert 'camera' in tf.problem
    for step in range(3):
        tf._buffer.set_transform(transform('gimbal_link', T + 0.1 * step, 0.3 * step), 'test')
    assert yaw_of(tf.rotation('microphones', T + 77.0)) == pytest.approx(0.5)
    assert yaw_of(tf.rotation('camera', T + 0.05)) == pytest.approx(0.25)
    assert yaw_of(tf.rotation('camera', T + 0.15)) == pytest.approx(0.55)
    assert yaw_of(tf.rotation('camera', T + 0.21)) == pytest.approx(0.7)
    assert not tf.problem
    with pytest.raises(NotYetKnownError):
        tf.rotation('camera', T + 0.25)
    assert tf.rotation('camera', T - 1.0) is None
    assert 'camera' in tf.problem
    assert tf.rotation('camera', T + 5.0) is None
