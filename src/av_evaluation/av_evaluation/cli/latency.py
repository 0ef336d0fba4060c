"""ros2 run av_evaluation latency: delay and processor time of fusion_node and pointing_node in separate processes.

Directions and poses are published at a rate; a delay is from the publication of a direction to the next command.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.node import Node
from tf2_ros import StaticTransformBroadcaster

from av_common.node import Executor
from av_common.qos import RESULT, STREAM
from av_common.stamps import to_stamp
from av_interfaces.msg import Doa, DoaArray, PointingCommand

LONGEST_MS, MOST_CPU = 5.0, 10.0


class Feed(Node):
    """Publishes directions and poses, and measures the delay of the command after each direction.

    Attributes:
        delays (ms): measured.

    Parameters:
        rate (Hz): of directions and poses.
    """

    def __init__(self, rate: float) -> None:
        super().__init__('fusion_benchmark')
        self._random = np.random.default_rng(1)
        self._doa = self.create_publisher(DoaArray, 'doa', STREAM)
        self._odometry = self.create_publisher(Odometry, 'odometry', STREAM)
        self.create_subscription(PointingCommand, 'pointing/command', self._on_command, RESULT)
        self._frames = StaticTransformBroadcaster(self)
        transform = TransformStamped(child_frame_id='microphones')
        transform.header.frame_id = 'base_link'
        transform.transform.rotation.w = 1.0
        self._frames.sendTransform(transform)
        self._sent: float | None = None
        self.delays: list[float] = []
        self.create_timer(1.0 / rate, self._send)

    def _send(self) -> None:
        now = self.get_clock().now().nanoseconds * 1e-9
        pose = Odometry()
        pose.header.stamp, pose.pose.pose.orientation.w = to_stamp(now), 1.0
        self._odometry.publish(pose)
        azimuth = 0.5 * math.sin(0.3 * now) + float(self._random.normal(0.0, 0.02))
        message = DoaArray(window=0.5, method='benchmark', axis=Vector3(x=0.0, y=1.0, z=0.0), hypotheses=[
            Doa(direction=Vector3(x=math.cos(a), y=math.sin(a), z=0.0), azimuth=a, azimuth_variance=4e-4,
                elevation_variance=math.inf, cosine=math.sin(a), cosine_variance=4e-4 * math.cos(a)**2, confidence=0.95)
            for a in (azimuth, math.pi - azimuth)])
        message.header.stamp, message.header.frame_id = to_stamp(now - 0.25), 'microphones'
        self._sent = time.perf_counter()
        self._doa.publish(message)

    def _on_command(self, message: PointingCommand) -> None:
        if self._sent is not None:
            self.delays.append(1e3 * (time.perf_counter() - self._sent))
            self._sent = None


def main(arguments: list[str] | None = None) -> int:
    """Print the figures; returns 1 where one misses its bound."""
    parser = argparse.ArgumentParser(prog='latency', description=__doc__)
    parser.add_argument('--rate', type=float, default=50.0, help='of directions and poses in Hz (%(default)s)')
    parser.add_argument('--seconds', type=float, default=20.0, help='to measure for, after a start of 8 s (%(default)s)')
    options = parser.parse_args(arguments)
    os.environ.setdefault('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    processes = {name: start_node(name) for name in ('fusion_node', 'pointing_node')}
    rclpy.init()
    feed = Feed(options.rate)
    executor = Executor()
    executor.add_node(feed)
    try:
        _spin(executor, 8.0)
        feed.delays.clear()
        before, begun = {name: cpu_seconds(process.pid) for name, process in processes.items()}, time.monotonic()
        _spin(executor, options.seconds)
        lasted = time.monotonic() - begun
        used = {name: 100.0 * (cpu_seconds(process.pid) - before[name]) / lasted for name, process in processes.items()}
    finally:
        for process in processes.values():
            process.terminate()
            process.wait(15.0)
        rclpy.shutdown()
    if len(feed.delays) < 0.5 * options.rate * options.seconds:
        print(f'latency: {len(feed.delays)} commands in {lasted:.0f} s', file=sys.stderr)
        return 1
    median, p95 = np.percentile(feed.delays, [50, 95])
    print(f'{options.rate:.0f} directions and poses a second, {len(feed.delays)} commands')
    print(f'delay of fusion and pointing: median {median:.2f} ms, 95th percentile {p95:.2f} ms (less than {LONGEST_MS:.0f})')
    for name, share in used.items():
        print(f'{name}: {share:.1f} % of a core (less than {MOST_CPU:.0f})')
    return 0 if p95 < LONGEST_MS and max(used.values()) < MOST_CPU else 1


def start_node(name: str) -> subprocess.Popen:
    """Start a node of the package `av_<name>` in a separate process."""
    package = f'av_{name.removesuffix("_node")}'
    return subprocess.Popen([sys.executable, '-c', f'from {package}.nodes.{name} import main; main()'])


def cpu_seconds(process_id: int) -> float:
    """Processor time (s) of a process (Linux)."""
    fields = Path(f'/proc/{process_id}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _spin(executor: Executor, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)


if __name__ == '__main__':
    sys.exit(main())
