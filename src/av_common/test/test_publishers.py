"""Who publishes an input, by the graph of real nodes in a namespace."""

from __future__ import annotations

import time

import pytest
import rclpy
from std_msgs.msg import String

from av_common.publishers import LEASE_S, Publishers

pytestmark = pytest.mark.system


@pytest.fixture
def publish():
    """A function that starts a node of this name, which publishes `odometry`."""
    rclpy.init()
    nodes = []

    def start(name):
        node = rclpy.create_node(name, namespace='left', enable_rosout=False)
        node.create_publisher(String, 'odometry', 1)
        nodes.append(node)
        return node

    yield start
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


@pytest.fixture
def publishers(publish):
    """Those of the inputs of a node that subscribes."""
    node = rclpy.create_node('listener', namespace='left')
    node.create_subscription(String, 'odometry', lambda message: None, 1)
    yield Publishers(node, ('odometry', 'doa'), {'odometry': 'model'})
    node.destroy_node()


def until(condition):
    """Wait for the graph, at most 10 s; whether the condition holds then."""
    deadline = time.monotonic() + 10.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return condition()


def test_a_second_publisher_is_named_until_it_ends(publish, publishers):
    publish('one')
    assert until(lambda: publishers._node.count_publishers('odometry') == 1) and publishers.contested(0.0) == {}
    other = publish('two')
    assert until(lambda: publishers.contested(0.0) == {'odometry': ['/left/one', '/left/two']})
    other.destroy_node()
    assert until(lambda: publishers.contested(0.0) == {})


def test_the_publishers_of_a_remapped_input_are_those_of_its_other_name(publish):
    """rclpy counts those of the name that is given."""
    node = rclpy.create_node('listener', namespace='left', cli_args=['--ros-args', '-r', 'pose:=odometry'])
    for name in ('one', 'two'):
        publish(name)
    assert until(lambda: Publishers(node, ('pose',)).contested(0.0) == {'pose': ['/left/one', '/left/two']})
    node.destroy_node()


def test_one_of_the_same_name_is_a_successor_for_the_lease_of_discovery(publish, publishers):
    for _ in range(2):
        publish('one')
    assert until(lambda: publishers._node.count_publishers('odometry') == 2)
    assert publishers.contested(5.0) == {} and publishers.contested(5.0 + LEASE_S) == {}
    assert publishers.contested(5.1 + LEASE_S) == {'odometry': ['/left/one', '/left/one']}


def test_a_node_of_the_rig_may_publish_besides_the_source(publish, publishers):
    """As its successor may; a second source may not."""
    for name in ('model', 'one', 'model'):
        publish(name)
    assert until(lambda: publishers._node.count_publishers('odometry') == 3)
    assert publishers.contested(5.0) == {} and publishers.contested(5.1 + LEASE_S)
    publish('two')
    assert until(lambda: publishers.contested(0.0) == {'odometry': ['/left/model', '/left/model', '/left/one', '/left/two']})
