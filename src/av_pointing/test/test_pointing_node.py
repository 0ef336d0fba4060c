"""pointing_node in its own process: nothing that happens to the clock moves the body."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from ros_domains import free_domain
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float32

from av_common.qos import LATCHED, RESULT, STREAM
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, PointingCommand

pytestmark = pytest.mark.system
START = 1000.0


class Bench:
    """Publishes clock, odometry and bearings at 50 Hz, and receives commands as (monotonic time in s, yaw rate)."""

    def __init__(self):
        domain = free_domain()
        self.process = subprocess.Popen(
            [sys.executable, '-c', 'from av_pointing.nodes.pointing_node import main; main()', '--ros-args',
             '-p', 'enabled:=true', '-p', 'use_sim_time:=true', '-p', 'move_gimbal:=false'],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)})
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('bench', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.clock = self.node.create_publisher(Clock, '/clock', RESULT)
        self.odometry = self.node.create_publisher(Odometry, 'odometry', STREAM)
        self.bearing = self.node.create_publisher(Bearing, 'target/bearing', RESULT)
        self.commands = []
        self.node.create_subscription(PointingCommand, 'pointing/command',
                                      lambda m: self.commands.append((time.monotonic(), m.yaw_rate)), RESULT)

    def run(self, seconds, time_of, measured_of):
        """Publish for some seconds; the functions give clock and `measured` from the seconds since the begin."""
        began = time.monotonic()
        while (elapsed := time.monotonic() - began) < seconds:
            now = time_of(elapsed)
            self.clock.publish(Clock(clock=to_stamp(now)))
            pose = Odometry()
            bearing = Bearing(state=Bearing.STATE_ACOUSTIC_ACTIVE, azimuth=2.5, azimuth_world=2.5, resolved=True)
            pose.pose.pose.orientation.w = 1.0
            pose.header.stamp = bearing.header.stamp = to_stamp(now)
            bearing.measured = to_stamp(measured_of(elapsed))
            self.odometry.publish(pose)
            self.bearing.publish(bearing)
            end = time.monotonic() + 0.02
            while time.monotonic() < end:
                self.executor.spin_once(timeout_sec=0.005)

    def run_until(self, condition, start=START):
        """Publish new measurements from a time on until it holds for the newest command's rate; returns whether it did."""
        steady = time.monotonic()
        for _ in range(20):
            self.run(0.5, lambda t: start + time.monotonic() - steady, lambda t: start + time.monotonic() - steady - 0.1)
            if self.commands and condition(self.commands[-1][1]):
                return True
        return False

    def close(self):
        self.process.kill()
        self.process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def bench():
    started = Bench()
    yield started
    started.close()


CLOCKS = {'runs': lambda t: t, 'stands': lambda t: 0.0, 'runs back': lambda t: -t,
          'jumps back and forth': lambda t: -5.0 if int(10 * t) % 2 else t, 'leaps': lambda t: t + 0.5 * int(4 * t)}


def test_whatever_the_clock_does_the_body_stops_with_the_measurements(bench):
    """0.3 s after `measured` stood still the node commands 0, and goes on commanding it."""
    for k, (name, clock) in enumerate(CLOCKS.items()):
        start, steady = START + 100.0 * k, time.monotonic()
        assert bench.run_until(lambda rate: rate > 0.3, start), name
        last = time.monotonic()
        now = start + last - steady
        bench.run(1.5, lambda t, now=now, clock=clock: now + clock(t), lambda t, now=now: now - 0.1)
        late = [(arrival - last, rate) for arrival, rate in bench.commands if arrival > last + 0.3 + 1.0 / 30.0]
        assert len(late) > 15 and all(rate == 0.0 for _, rate in late), (name, late[:5])


def test_a_limit_ends_with_its_last_publisher(bench):
    """A limit of almost nothing holds while somebody states it, and not for good."""
    assert bench.run_until(lambda rate: rate > 0.3)
    limits = bench.node.create_publisher(Float32, 'yaw_rate_limit', LATCHED)
    limits.publish(Float32(data=1e-6))
    assert bench.run_until(lambda rate: rate <= 1e-5)
    bench.node.destroy_publisher(limits)
    assert bench.run_until(lambda rate: rate > 0.3)
