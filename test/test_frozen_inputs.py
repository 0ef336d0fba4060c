"""The live rig stands still when its inputs freeze, and tracks again when they return."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager

import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rig_process import RigProcess
from udp_ports import free_offset

from av_common.qos import RESULT, STREAM
from av_common.stamps import to_seconds
from av_interfaces.msg import Bearing, PointingCommand

pytestmark = pytest.mark.system
BODY_TIMEOUT = 0.3
PERIOD = 1.0 / 30.0    # of commands: one that is sent just before the time is up holds until the next


class Listener:
    """Bearings, commands and true yaw rates of a rig with their arrival, times of this machine's clock in s."""

    def __init__(self, node):
        self.bearings, self.commands, self.yaw_rates = [], [], []
        node.create_subscription(Bearing, 'target/bearing', lambda m: self.bearings.append((time.time(), m)), RESULT)
        node.create_subscription(
            Odometry, 'truth/rig', lambda m: self.yaw_rates.append((time.time(), m.twist.twist.angular.z)), STREAM)
        node.create_subscription(PointingCommand, 'pointing/command', lambda m: self.commands.append((time.time(), m)), RESULT)

    def newest_measurement(self):
        """When the newest measurement in a bearing arrived."""
        arrived, newest = 0.0, 0.0
        for arrival, bearing in self.bearings:
            if to_seconds(bearing.measured) > newest:
                arrived, newest = arrival, to_seconds(bearing.measured)
        return arrived

    def turning(self, since):
        """Stamps of the commands since a time that turn the body."""
        stamps = [(to_seconds(command.header.stamp), command.yaw_rate) for _, command in self.commands]
        return [stamp for stamp, rate in stamps if stamp > since and rate != 0.0]


@contextmanager
def listening(domain):
    """A `Listener` in the domain of a rig, and a function that listens for some seconds."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('listener', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def listen(seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            executor.spin_once(timeout_sec=0.05)

    try:
        yield Listener(node), listen
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_nothing_turns_on_what_is_frozen():
    """The target circles, so that the body turns all the time; processes are stopped one after the other, and continued."""
    rig = RigProcess('scenario:=circle', 'oracle:=true', f'port_offset:={free_offset()}')
    with listening(rig.domain) as (seen, listen):
        for frozen in ('lib/av_simulator/simulator', 'lib/av_sim_bridge/bridge_node'):
            with stopped(rig, seen, listen, frozen):
                the_body_stands_still_0_3_s_after_the_last_measurement(seen, listen)
            continued = time.time()
            listen(30.0, lambda continued=continued: len(seen.turning(continued + 1.0)) > 20)
            assert len(seen.turning(continued + 1.0)) > 20 and seen.newest_measurement() > continued
        for frozen in ('lib/av_fusion/fusion_node', 'lib/av_pointing/pointing_node'):
            with stopped(rig, seen, listen, frozen) as since:
                listen(3.0)
                rates = [rate for arrival, rate in seen.yaw_rates if arrival > since + 1.0]
                assert rates and max(map(abs, rates)) < 1e-3, (frozen, max(map(abs, rates)))    # the rig brakes by itself
    rig.interrupt()
    rig.finish(timeout=60.0)


@contextmanager
def stopped(rig, seen, listen, name):
    """A process is stopped while the body turns; the time since when."""
    listen(90.0, lambda: len(seen.turning(time.time() - 2.0)) > 20)
    assert seen.turning(time.time() - 2.0), rig.output
    process = rig.processes(name)[0]
    os.kill(process, signal.SIGSTOP)
    yield time.time()
    os.kill(process, signal.SIGCONT)


def the_body_stands_still_0_3_s_after_the_last_measurement(seen, listen):
    listen(4.0)
    arrived, commands = seen.newest_measurement(), [command for _, command in seen.commands[-20:]]
    late = seen.turning(arrived + BODY_TIMEOUT + PERIOD)
    assert not late, f'turns until {late[-1] - arrived:.2f} s after the newest measurement'
    assert time.time() - arrived > 3.0 and to_seconds(commands[-1].header.stamp) > time.time() - 0.5
    assert all(command.mode == PointingCommand.MODE_HOLD for command in commands), commands[-1]
    predicted = [bearing for arrival, bearing in seen.bearings if arrival > arrived + 1.5]
    assert predicted and {bearing.state for bearing in predicted} <= {Bearing.STATE_COASTING, Bearing.STATE_NONE}
