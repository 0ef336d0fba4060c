"""Of two publishers of one input, nodes use neither."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import SingleThreadedExecutor
from ros_domains import free_domain

from av_common.qos import RESULT
from av_interfaces.msg import PointingCommand
from av_pointing.nodes.pointing_node import PointingNode
from av_pointing.nodes.rig_frames_node import RigFramesNode

pytestmark = pytest.mark.system
RIG = Path(__file__).resolve().parents[3] / 'config/rig_gimbal.yaml'


class Bench:
    """A node, and two others that publish one of its inputs."""

    def __init__(self, make, kind, topic, names=('one', 'another'), **parameters):
        rclpy.init(args=['--ros-args', *(word for name, value in parameters.items() for word in ('-p', f'{name}:={value}'))],
                   domain_id=free_domain())
        self.executor, self.node = SingleThreadedExecutor(), make()
        self.senders = [rclpy.create_node(name) for name in names]
        for each in (self.node, *self.senders):
            self.executor.add_node(each)
        self.publishers = [sender.create_publisher(kind, topic, RESULT) for sender in self.senders]

    def spin(self, seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self.executor.spin_once(timeout_sec=0.02)

    def publish(self, message, frame, times):
        for _ in range(times):
            message.header.stamp, message.header.frame_id = self.node.get_clock().now().to_msg(), frame
            for publisher in self.publishers:
                publisher.publish(message)
            self.spin(0.05)

    def leave_one(self, topic):
        self.senders[1].destroy_publisher(self.publishers.pop())
        self.spin(20.0, lambda: topic not in self.node.contested)

    def close(self):
        self.node.close()
        self.executor.shutdown()
        rclpy.try_shutdown()


@pytest.fixture
def bench():
    """Makes a bench, and closes it."""
    made = []

    def make(*arguments, **parameters):
        made.append(Bench(*arguments, **parameters))
        made[0].spin(20.0, lambda: made[0].node.is_active and made[0].node.contested)
        return made[0]
    yield make
    made[0].close()


def test_commands_move_no_model_of_the_gimbal(bench):
    """Nor do they move the gimbal."""
    rig = bench(RigFramesNode, PointingCommand, 'pointing/command', rig_file=RIG)
    command = PointingCommand(move_gimbal=True, pan=1.0)
    rig.publish(command, 'base_stabilized', 20)
    assert rig.node.is_active and abs(rig.node._stage.history.newest.attitude_wxyz[3]) < 0.01
    rig.leave_one('pointing/command')
    rig.publish(command, 'base_stabilized', 60)
    assert rig.node._stage.history.newest.attitude_wxyz[3] > 0.2


def test_cues_turn_no_gimbal(bench):
    rig = bench(PointingNode, PointStamped, 'target/cue', follow_cues='true', enabled='true')
    cue = PointStamped()
    cue.point.x, cue.point.y = 10.0, 10.0
    rig.publish(cue, 'base_link', 20)
    assert rig.node.is_active and rig.node._stage.command.pan == pytest.approx(0.0)
    rig.leave_one('target/cue')
    rig.publish(cue, 'base_link', 20)
    assert rig.node._stage.command.pan > 0.3


def test_tasks_and_a_network_may_cue_the_gimbal_both():
    """Each of the suite's own two sources counts; report_node publishes cues for tasks only, but always may."""
    rig = Bench(PointingNode, PointStamped, 'target/cue', ('network_node', 'report_node'), follow_cues='true', enabled='true')
    try:
        rig.spin(20.0, lambda: rig.node.is_active and rig.node.count_publishers('target/cue') == 2)
        rig.publishers.pop()
        cue = PointStamped()
        cue.point.x, cue.point.y = 10.0, 10.0
        rig.publish(cue, 'base_link', 20)
        assert not rig.node.contested and rig.node._stage.command.pan > 0.3
    finally:
        rig.close()
