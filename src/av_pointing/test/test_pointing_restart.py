"""A pointing_node that replaces one that has died commands what that one commanded last: nothing jerks, nothing is enabled."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from ros_domains import free_domain

from av_common.launched import RESTARTS, RUN_FOLDER, KeptNumbers, KeptSwitch
from av_common.qos import RESULT
from av_interfaces.msg import PointingCommand
from av_pointing.controller import PointingController


def first_command(environment):
    """The first command of a new pointing_node that is enabled by its parameters."""
    domain = free_domain()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node, executor, commands = rclpy.create_node('bench', context=context), SingleThreadedExecutor(context=context), []
    node.create_subscription(PointingCommand, 'pointing/command', commands.append, RESULT)
    executor.add_node(node)
    process = subprocess.Popen(
        [sys.executable, '-c', 'from av_pointing.nodes.pointing_node import main; main()', '--ros-args', '-p', 'enabled:=true'],
        env={**os.environ, **environment, 'ROS_DOMAIN_ID': str(domain)})
    deadline = time.monotonic() + 60.0
    try:
        while not commands and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
    finally:
        process.kill()
        process.wait()
        node.destroy_node()
        rclpy.shutdown(context=context)
    return commands[0]


@pytest.mark.system
@pytest.mark.parametrize('enabled', [True, False])
def test_a_restarted_node_continues(enabled, tmp_path, monkeypatch):
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    KeptNumbers('/pointing_node.angles', (0.0, 0.0)).keep(0.7, -0.2)
    KeptSwitch('/pointing_node.enabled', initial=enabled)
    command = first_command({RUN_FOLDER: str(tmp_path), RESTARTS: '1'})
    assert (command.pan, command.tilt) == pytest.approx((0.7, -0.2))
    assert (command.pan_rate, command.tilt_rate, command.yaw_rate) == (0.0, 0.0, 0.0)
    assert command.move_gimbal == command.move_body == enabled


def test_a_controller_starts_within_its_limits():
    controller = PointingController()
    controller.start_at(9.0, -math.inf)
    assert controller.gimbal.pan.position == controller.settings.pan.upper
    assert controller.gimbal.tilt.position == controller.settings.tilt.lower
