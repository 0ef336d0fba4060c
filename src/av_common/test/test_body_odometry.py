"""Odometry of a sensor that is mounted turned, as that of the body, for nodes and for replays."""

import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from ros_domains import free_domain
from scipy.spatial.transform import Rotation
from tf2_msgs.msg import TFMessage

from av_common.body_odometry import MOST_FRAMES, TF_WAIT_S, BodyOdometry, FixedFrames
from av_common.gimbal_history import NotYetKnownError
from av_common.node import RigNode
from av_common.qos import LATCHED, STREAM
from av_common.stamps import to_stamp

MOUNT = Rotation.from_euler('ZYX', [90.0, 0.0, 180.0], degrees=True)    # of a sensor on the body: turned, upside down
BODY = Rotation.from_euler('ZYX', [40.0, 10.0, -5.0], degrees=True)
RATE, VELOCITY = np.array([0.1, -0.2, 0.7]), np.array([3.0, 0.5, -0.2])    # of the body, in its own frame


def quaternion(rotation):
    return Quaternion(**dict(zip('xyzw', map(float, rotation.as_quat()), strict=True)))


def transform(child, parent, rotation=MOUNT):
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.transform.rotation = parent, quaternion(rotation)
    return message


def odometry(frame, at=0.0):
    """What a sensor of that frame reports while the body is at BODY."""
    message = Odometry(child_frame_id=frame)
    message.header.stamp, message.header.frame_id = to_stamp(at), 'odom'
    message.pose.pose.orientation = quaternion(BODY * MOUNT)
    for name, vector in (('angular', RATE), ('linear', VELOCITY)):
        setattr(message.twist.twist, name, Vector3(**dict(zip('xyz', MOUNT.inv().apply(vector).tolist(), strict=True))))
    return message


def attitude(message):
    q = message.pose.pose.orientation
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


def is_body(message):
    twist = message.twist.twist
    return (message.child_frame_id == 'base_link' and (attitude(message) * BODY.inv()).magnitude() < 1e-6
            and np.allclose([twist.angular.x, twist.angular.y, twist.angular.z], RATE)
            and np.allclose([twist.linear.x, twist.linear.y, twist.linear.z], VELOCITY))


@pytest.mark.parametrize('tree', [
    [('imu', 'base_link', MOUNT)], [('base_link', 'imu', MOUNT.inv())], [('/imu', '/base_link', MOUNT)],
    [('imu', 'base_footprint', MOUNT), ('base_link', 'base_footprint', Rotation.identity())],
    [('plate', 'base_link', Rotation.from_euler('z', 30.0, degrees=True)),
     ('imu', 'plate', Rotation.from_euler('z', -30.0, degrees=True) * MOUNT), ('base_link', 'odom', BODY)]])
def test_wherever_the_body_is_in_the_tree(tree):
    frames = FixedFrames()
    assert frames.learn([transform(*one) for one in tree]) == []
    assert is_body(BodyOdometry(frames.rotation).of_body(odometry('imu')))


def test_frames_without_number_take_no_memory():
    frames = FixedFrames()
    frames.learn([transform(f'frame_{number}', 'base_link') for number in range(2 * MOST_FRAMES)])
    assert frames.rotation(f'frame_{MOST_FRAMES - 1}') is not None and frames.rotation(f'frame_{MOST_FRAMES}') is None
    body = BodyOdometry(lambda frame: None)
    for number in range(MOST_FRAMES):
        body.of_body(odometry(f'frame_{number}'))
    with pytest.raises(ValueError, match='more than 500 frames'):
        body.of_body(odometry('another'))
    assert body.of_body(odometry('base_link')) and len(body.assumed) == MOST_FRAMES


def test_a_loop_or_an_impossible_rotation_joins_nothing():
    frames = FixedFrames()
    assert frames.learn([transform('a', 'b'), transform('b', 'a')]) == []
    assert frames.rotation('a') is None
    broken = transform('imu', 'base_link')
    broken.transform.rotation = Quaternion(w=0.0)
    assert frames.learn([broken]) == ['imu'] and frames.rotation('imu') is None


def test_an_unknown_frame_is_waited_for_and_then_counts_as_the_bodys():
    frames = FixedFrames()
    bodies = BodyOdometry(frames.rotation, TF_WAIT_S)
    for frame in ('base_link', '/base_link', ''):
        assert bodies.of_body(odometry(frame)) == odometry(frame)
    with pytest.raises(NotYetKnownError, match="'imu'"):
        bodies.of_body(odometry('imu', 100.0))
    late = odometry('imu', 100.0 + TF_WAIT_S)
    assert bodies.of_body(late) is late and bodies.assumed == {'imu'}
    frames.learn([transform('imu', 'base_link')])
    assert is_body(bodies.of_body(late)) and not bodies.assumed


class Rover(RigNode):
    """Takes odometry."""

    def __init__(self):
        self.taken = []
        super().__init__('rover')

    def activate(self):
        self.subscribe_odometry(self.taken.append)


@pytest.mark.system
def test_a_node_takes_odometry_of_a_sensor_as_the_bodys_and_says_what_it_assumes():
    rclpy.init(domain_id=free_domain())
    executor, other, rover, told = SingleThreadedExecutor(), rclpy.create_node('robot'), Rover(), []
    other.create_subscription(DiagnosticArray, '/diagnostics', lambda message: told.extend(message.status), 10)
    publishers = other.create_publisher(TFMessage, 'tf_static', LATCHED), other.create_publisher(Odometry, 'odometry', STREAM)
    for node in (other, rover):
        executor.add_node(node)

    def send_until(frame, condition):
        end = time.monotonic() + 20.0
        while not condition() and time.monotonic() < end:
            publishers[1].publish(odometry(frame, time.time()))
            executor.spin_once(timeout_sec=0.02)
        assert condition()

    send_until('imu', lambda: any("'imu'" in one.message and one.level == DiagnosticStatus.WARN for one in told))
    publishers[0].publish(TFMessage(transforms=[transform('imu', 'base_link')]))
    send_until('imu', lambda: any(map(is_body, rover.taken[-1:])))
    told.clear()
    send_until('imu', lambda: any(one.name.startswith('rover') and one.level == DiagnosticStatus.OK for one in told))
    rover.close()
    for node in (rover, other):
        node.destroy_node()
    executor.shutdown()
    rclpy.try_shutdown()
