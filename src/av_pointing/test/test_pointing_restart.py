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
from std_srvs.srv import SetBool

from av_common.launched import RESTARTS, RUN_FOLDER, KeptNumbers
from av_common.qos import RESULT
from av_interfaces.msg import PointingCommand
from av_pointing.nodes.pointing_node import DRAINED_S, PAUSE_S, PointingNode


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
@pytest.mark.parametrize(('enabled', 'kept', 'begins'), [
    (True, (0.7, -0.2), (0.7, -0.2)), (False, (9.0, -9.0), (math.radians(150.0), math.radians(-80.0)))])
def test_a_restarted_node_continues_within_its_limits(enabled, kept, begins, tmp_path, monkeypatch):
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    KeptNumbers('/pointing_node.angles', (0.0, 0.0)).keep(*kept)
    KeptNumbers('/pointing_node.enabled', (enabled,))
    command = first_command({RUN_FOLDER: str(tmp_path), RESTARTS: '1'})
    assert (command.pan, command.tilt) == pytest.approx(begins)
    assert (command.pan_rate, command.tilt_rate, command.yaw_rate) == (0.0, 0.0, 0.0)
    assert command.move_gimbal == command.move_body == enabled


@pytest.mark.parametrize('end', ['trigger_deactivate', 'trigger_shutdown'])
def test_what_was_ended_on_request_moves_nothing_in_a_later_process(end, tmp_path, monkeypatch):
    """The launch starts a process again that ends."""
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    rclpy.init(args=['--ros-args', '-p', 'enabled:=true', '-p', 'autostart:=false'], domain_id=free_domain())
    node = PointingNode()
    node.trigger_configure()
    node.trigger_activate()
    assert node._stage.controller.enabled
    getattr(node, end)()
    node.destroy_node()
    rclpy.shutdown()
    monkeypatch.setenv(RESTARTS, '1')
    assert KeptNumbers('/pointing_node.enabled', (True,)).values == (0.0,)


def test_a_node_that_stood_still_does_not_obey_a_request_that_may_have_waited():
    """As after SIGSTOP and SIGCONT: neither before nor after its timer ran again; it may always be disabled."""
    rclpy.init(args=['--ros-args', '-p', 'enabled:=false', '-p', 'autostart:=false'], domain_id=free_domain())
    node, executor = PointingNode(), SingleThreadedExecutor()
    executor.add_node(node)
    node.trigger_configure()
    node.trigger_activate()

    def ask(data):
        return node._on_enable(SetBool.Request(data=data), SetBool.Response())

    try:
        assert ask(True).success and node._stage.controller.enabled
        assert ask(False).success and not node._stage.controller.enabled
        time.sleep(PAUSE_S + 0.1)
        assert 'ask again' in ask(True).message
        node._on_time()
        assert not ask(True).success and not node._stage.controller.enabled and ask(False).success
        end = time.monotonic() + 10.0
        began = time.monotonic()
        while not (answer := ask(True)).success and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.02)
        assert answer.success and node._stage.controller.enabled and time.monotonic() - began > 0.8 * DRAINED_S
    finally:
        node.close()
        node.destroy_node()
        rclpy.shutdown()
