"""Rigs that join a running node."""

from __future__ import annotations

import time

import pytest
import rclpy
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.serialization import serialize_message
from std_msgs.msg import Header, String

from av_common.node import Executor
from av_common.qos import STREAM
from av_common.stamps import to_stamp
from av_interfaces.msg import RigReport
from av_network.nodes import network_node
from av_network.nodes.network_node import NetworkNode

pytestmark = pytest.mark.system
LONG_S = 30.0


def test_a_rig_joins_whatever_else_is_published_under_its_name(monkeypatch):
    """Others cannot keep it out by messages of another type. Of one that finds no place /diagnostics tells."""
    monkeypatch.setattr(network_node, 'MOST_RIGS', 1)
    rclpy.init(args=['--ros-args', '-p', 'join:=true', '-p', 'pose_sources:=[odometry]'])
    node, rig, executor = NetworkNode(), rclpy.create_node('rig', namespace='left'), Executor()
    try:
        rig.create_publisher(String, 'network/report', STREAM)
        reports = rig.create_publisher(RigReport, 'network/report', STREAM)
        for each in (node, rig):
            executor.add_node(each)
        end = time.monotonic() + LONG_S
        while not (node.is_active and any(each.newest > 0.0 for each in node._stage.rigs.values())):
            assert time.monotonic() < end, 'it did not join'
            reports.publish(RigReport(version=RigReport.VERSION, header=Header(stamp=to_stamp(node.now()))))
            executor.spin_once(timeout_sec=0.05)
        rig.create_publisher(RigReport, '/right/network/report', STREAM)
        while 'timer _look' not in node.refused.counts:
            assert time.monotonic() < end, 'nothing is said of the other one'
            executor.spin_once(timeout_sec=0.05)
        assert list(node._stage.rigs) == ['left']
        # Another version says so; before there were any, the stamp was first.
        for number, first in ((7, RigReport(version=7)), (10_000, Header(stamp=to_stamp(10_000.0)))):
            reports.publish(serialize_message(first))
            wanted = f'left reports by version {number}, expected 2: install the same release on all rigs'
            said = DiagnosticStatusWrapper()
            while wanted not in said.message:
                assert time.monotonic() < end, 'it is not refused'
                executor.spin_once(timeout_sec=0.05)
                said = DiagnosticStatusWrapper()
                node.refused.report(said)
    finally:
        node.close()
        for each in (node, rig):
            each.destroy_node()
        rclpy.try_shutdown()
