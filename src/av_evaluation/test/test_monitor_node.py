"""The monitor's line of a second."""

from __future__ import annotations

import math

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry

from av_bags.topics import TRUE_RIG, TRUE_TARGET
from av_common.stamps import to_stamp
from av_common.track import State, Track
from av_common.track_messages import bearing_message
from av_evaluation.nodes.monitor_node import MonitorNode

pytestmark = pytest.mark.system


@pytest.fixture
def node(request):
    """The node in the namespace that a test is given, else in none."""
    rclpy.init(args=['--ros-args', '-p', 'autostart:=false', '-r', f'__ns:={getattr(request, "param", "/")}'])
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


@pytest.mark.parametrize(('node', 'shown'), [('/left', 'left/camera_node: absent'), ('/right', 'right/doa_node: silent'),
                                             ('/', 'camera_node: absent')], indirect=['node'])
def test_problems_are_those_of_the_rig_itself(node, shown, capsys):
    """Several rigs of one network, each of which says what is wrong with its nodes."""
    others = (('left/camera_node', 'absent'), ('right/doa_node', 'silent'), ('camera_node', 'absent'))
    node._on_diagnostics(DiagnosticArray(status=[
        DiagnosticStatus(name=f'{name}: status', message=message, level=DiagnosticStatus.ERROR) for name, message in others]))
    node._each_second()
    assert [line.strip() for line in capsys.readouterr().out.splitlines() if '!' in line] == [f'! {shown}']
