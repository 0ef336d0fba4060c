"""The monitor's line of a second."""

from __future__ import annotations

import math

import pytest
import rclpy
from nav_msgs.msg import Odometry

from av_bags.topics import TRUE_RIG, TRUE_TARGET
from av_common.stamps import to_stamp
from av_common.track import State, Track
from av_common.track_messages import bearing_message
from av_evaluation.nodes.monitor_node import MonitorNode

pytestmark = pytest.mark.system


@pytest.fixture
def node():
    rclpy.init(args=['--ros-args', '-p', 'autostart:=false'])
    made = MonitorNode()
    made.trigger_configure()
    yield made
    rclpy.try_shutdown()


def test_the_truth_is_shown_also_after_the_clock_was_set(node, capsys):
    """As when a rig without a battery for its clock hears of the time, or a bag that is played begins again."""
    for begin in (1000.0, 1.7e9, 5000.0):
        for k in range(40):
            now = begin + 0.05 * k
            node.now = lambda now=now: now
            for name, x in ((TRUE_RIG, 0.0), (TRUE_TARGET, 10.0)):
                truth = Odometry()
                truth.header.stamp = to_stamp(now)
                truth.pose.pose.position.x = truth.pose.pose.position.y = x
                node._on_truth(name, truth)
            node._on_bearing(bearing_message(Track(now, State.VISUAL_ACTIVE, azimuth=0.7, measured=now), 'base_link'))
        assert node._shown()[1] == pytest.approx(math.pi / 4.0)
    node._each_second()
    assert 'truth  +45.0' in capsys.readouterr().out


def test_each_deactivation_prints_the_figures(node, capsys):
    for _ in range(2):
        node.trigger_activate()
        node.trigger_deactivate()
        assert 'coverage' in capsys.readouterr().out
