"""Transforms that would spoil tf2's buffer for good: refused, while the rig's frames stay known."""

import math
import time

import pytest
import rclpy
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from tf2_msgs.msg import TFMessage

from av_common.qos import LATCHED, RESULT
from av_common.stamps import to_stamp
from av_common.tf_rotations import TfRotations

pytestmark = pytest.mark.system

BASE, ARRAY, GIMBAL = 'base_link', 'microphones', 'gimbal_link'


@pytest.fixture
def tf():
    rclpy.init()
    node = rclpy.create_node('tf_listener_test')
    rotations = TfRotations(node)
    rotations.node = node
    rotations.now = math.floor(1e-9 * node.get_clock().now().nanoseconds)    # a number that a float holds
    rotations.fixed = rotations.static_callback
    rotations.moving = rotations.callback
    yield rotations
    node.destroy_node()
    rclpy.shutdown()


def transform(child, parent=BASE, time=0.0, yaw=0.3, x=0.0, turn=None):
    turn = turn or Quaternion(w=math.cos(0.5 * yaw), z=math.sin(0.5 * yaw))
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, to_stamp(time)
    message.transform.rotation, message.transform.translation = turn, Vector3(x=x)
    return message


def yaw(rotation):
    return math.atan2(rotation[1, 0], rotation[0, 0])


HOSTILE = [
    (BASE, ARRAY, {}, 'a loop'), (BASE, BASE, {}, 'a loop'), (f'/{BASE}', f'/{ARRAY}', {}, 'a loop'),
    ('other', BASE, {'x': math.nan}, 'not finite'), (BASE, ARRAY, {'x': math.inf}, 'not finite'),
    ('other', BASE, {'turn': Quaternion(w=0.0)}, 'no unit quaternion'),
    ('other', BASE, {'turn': Quaternion(w=math.nan)}, 'no unit quaternion'), ('', BASE, {}, 'without name'),
    ('other', '', {}, 'without name')]


@pytest.mark.parametrize(('child', 'parent', 'given', 'reason'), HOSTILE)
@pytest.mark.parametrize('topic', ['fixed', 'moving'])
def test_what_would_spoil_the_tree_is_refused_with_its_reason_and_the_rest_is_taken(tf, child, parent, given, reason, topic):
    tf.fixed(TFMessage(transforms=[transform(ARRAY)]))
    with pytest.raises(ValueError, match=reason):
        getattr(tf, topic)(TFMessage(transforms=[transform(child, parent, **given), transform('late', time=tf.now)]))
    assert yaw(tf.rotation(ARRAY, tf.now)) == pytest.approx(0.3)
    assert yaw(tf.rotation('late', tf.now)) == pytest.approx(0.3, abs=1e-5)


def test_a_stamp_that_is_none_is_refused_and_the_rest_is_taken(tf):
    tf.fixed(TFMessage(transforms=[transform(ARRAY)]))
    with pytest.raises(ValueError, match='other.*: stamp 5 s 4000000000 ns'):
        wrong = transform('other', time=5.0)
        wrong.header.stamp.nanosec = 4_000_000_000
        tf.moving(TFMessage(transforms=[wrong, transform('late', time=tf.now)]))
    assert yaw(tf.rotation('late', tf.now)) == pytest.approx(0.3, abs=1e-5)


def test_a_long_loop_is_refused_whatever_the_order(tf):
    tf.fixed(TFMessage(transforms=[transform('a', BASE), transform('b', 'a'), transform(ARRAY, 'b')]))
    with pytest.raises(ValueError, match='a loop'):
        tf.fixed(TFMessage(transforms=[transform(BASE, ARRAY)]))
    tf.fixed(TFMessage(transforms=[transform(BASE, 'odom'), transform('odom', 'map')]))    # a robot's tree above the body
    assert yaw(tf.rotation(ARRAY, tf.now)) == pytest.approx(0.9)


def test_a_fixed_frame_that_was_moved_is_back_when_it_is_repeated(tf):
    tf.fixed(TFMessage(transforms=[transform(ARRAY)]))
    tf.fixed(TFMessage(transforms=[transform(ARRAY, 'nowhere')]))
    assert tf.rotation(ARRAY, tf.now) is None
    tf.fixed(TFMessage(transforms=[transform(ARRAY)]))
    assert yaw(tf.rotation(ARRAY, tf.now)) == pytest.approx(0.3)
    with pytest.raises(ValueError, match='fixed frame'):
        tf.moving(TFMessage(transforms=[transform(ARRAY, time=tf.now, yaw=1.0)]))
    assert yaw(tf.rotation(ARRAY, tf.now)) == pytest.approx(0.3)


@pytest.mark.parametrize('ahead', [1.0, 60.0, 1e8])
def test_a_stamp_of_the_future_does_not_hide_those_that_follow(tf, ahead):
    """Tf2 takes no transform that is 10 s older than its newest."""
    tf.moving(TFMessage(transforms=[transform(GIMBAL, time=tf.now)]))
    now = 1e-9 * tf.node.get_clock().now().nanoseconds    # up to a second later than tf.now
    with pytest.raises(ValueError, match='future'):
        tf.moving(TFMessage(transforms=[transform(GIMBAL, time=now + ahead, yaw=2.0)]))
    tf.moving(TFMessage(transforms=[transform(GIMBAL, time=tf.now + 0.02, yaw=0.4)]))
    assert yaw(tf.rotation(GIMBAL, tf.now + 0.01)) == pytest.approx(0.35, abs=1e-3)


def test_frames_without_number_take_no_memory(tf):
    with pytest.raises(ValueError, match='more than 500 frames'):
        tf.moving(TFMessage(transforms=[transform(f'frame_{number}', time=tf.now) for number in range(2000)]))
    assert tf._buffer.all_frames_as_string().count('\n') < 600


def test_frames_of_the_same_names_stay_with_their_rigs(tf):
    """One node that looks at two rigs, as the page does: each on a tf of its own, and none on /tf."""
    node = tf.node
    rigs = {name: TfRotations(node, namespace=f'/{name}/') for name in ('left', 'right')}
    senders = {name: [node.create_publisher(TFMessage, f'{name}/{topic}', qos)
                      for topic, qos in (('tf_static', LATCHED), ('tf', RESULT))] for name in rigs}
    common = [node.create_publisher(TFMessage, topic, qos) for topic, qos in (('/tf_static', LATCHED), ('/tf', RESULT))]
    angles = {'left': 0.4, 'right': -1.2}
    sent = [(common, 2.5), *((senders[name], angle) for name, angle in angles.items())]
    for publishers, angle in sent:
        publishers[0].publish(TFMessage(transforms=[transform(ARRAY, yaw=angle)]))

    def known(frame):
        return all(rotations.rotation(frame, tf.now) is not None for rotations in (tf, *rigs.values()))
    deadline = time.monotonic() + 60.0
    while not (known(ARRAY) and known(GIMBAL)):
        assert time.monotonic() < deadline
        for publishers, angle in sent:    # what is sent before a listener was found is lost
            publishers[1].publish(TFMessage(transforms=[transform(GIMBAL, time=tf.now, yaw=angle + 0.1)]))
        rclpy.spin_once(node, timeout_sec=0.1)
    for rotations, angle in ((tf, 2.5), *((rigs[name], angle) for name, angle in angles.items())):
        assert yaw(rotations.rotation(ARRAY, tf.now)) == pytest.approx(angle, abs=1e-5)
        assert yaw(rotations.rotation(GIMBAL, tf.now)) == pytest.approx(angle + 0.1, abs=1e-5)
