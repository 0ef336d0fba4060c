"""Latency from a bearing to the command to the vehicle, through pointing_node and px4_node in separate processes.

ros2 run av_evaluation px4_latency [--seconds 20] [--rate 50]        needs px4_msgs, see docs/reference/px4.md
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import rclpy
from std_msgs.msg import Header

from av_common.node import Executor  # one of two, by ROS's version
from av_common.qos import RESULT
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing
from av_px4.commands import GIMBAL_PITCH_YAW
from av_px4.guard import OFFBOARD
from av_px4.nodes.px4_link import PX4_QOS, load_px4_msgs

NODES = {'av_pointing.nodes.pointing_node': ['-p', 'enabled:=true'], 'av_px4.nodes.px4_node': []}
LIMIT_MS = 10.0    # upper bound of the 95th percentile


class LatencyProbe:
    """Publishes bearings and measures the latencies (s) of the commands that follow from them.

    It also simulates an armed vehicle in OFFBOARD that acknowledges every command at once.

    Parameters:
        messages: the module px4_msgs.msg
    """

    def __init__(self, messages: Any) -> None:
        self._messages, self._node = messages, rclpy.create_node('px4_benchmark')
        self._bearings = self._node.create_publisher(Bearing, 'target/bearing', RESULT)
        names = {'vehicle_status': 'VehicleStatus', 'vehicle_attitude': 'VehicleAttitude',
                 'vehicle_local_position': 'VehicleLocalPosition', 'vehicle_command_ack': 'VehicleCommandAck'}
        self._outputs = {name: self._node.create_publisher(*self._topic('out', name, kind), PX4_QOS)
                         for name, kind in names.items()}
        for name, kind, callback in (('vehicle_command', 'VehicleCommand', self._on_command),
                                     ('trajectory_setpoint', 'TrajectorySetpoint', self._on_setpoint),
                                     ('offboard_control_mode', 'OffboardControlMode', lambda _: None)):
            self._node.create_subscription(*self._topic('in', name, kind), callback, PX4_QOS)
        self._sent_at: dict[str, float | None] = {'gimbal': None, 'body': None}
        self.latencies: dict[str, list[float]] = {'gimbal': [], 'body': []}
        self.bearings = 0

    def run(self, seconds: float, rate: float) -> None:
        """Publish bearings. Raises RuntimeError when no command to the gimbal arrives within 30 s.

        Parameters:
            seconds (s): duration of the measurement, counted from the end of a warm-up of 50 commands
            rate (Hz): rate of the bearings
        """
        executor = Executor()
        executor.add_node(self._node)
        begin, ready, due, ticks = time.monotonic(), None, time.monotonic(), 0
        while ready is None or time.monotonic() < ready + seconds:
            if ready is None and time.monotonic() > begin + 30.0:
                raise RuntimeError('no command to the gimbal within 30 s')
            executor.spin_once(timeout_sec=max(0.0, due - time.monotonic()))
            if time.monotonic() >= due:
                self._send_vehicle(ticks)
                if ticks % max(1, round(200.0 / rate)) == 0:
                    self._send_bearing(math.radians(20.0) * math.sin(ticks / 200.0))
                due, ticks = max(due + 0.005, time.monotonic() - 0.02), ticks + 1
            if ready is None and all(len(latencies) > 50 for latencies in self.latencies.values()):
                ready, self.bearings, self.latencies = time.monotonic(), 0, {'gimbal': [], 'body': []}

    def _topic(self, side: str, name: str, kind: str) -> tuple[type, str]:
        message = getattr(self._messages, kind)
        version = getattr(message, 'MESSAGE_VERSION', 0)
        return message, f'fmu/{side}/{name}' + (f'_v{version}' if version else '')

    def _send_vehicle(self, tick: int) -> None:
        messages, level = self._messages, [1.0, 0.0, 0.0, 0.0]
        if tick % 2 == 0:
            self._outputs['vehicle_attitude'].publish(messages.VehicleAttitude(timestamp_sample=1 + 5000 * tick, q=level))
            self._outputs['vehicle_local_position'].publish(messages.VehicleLocalPosition(xy_valid=True, z_valid=True))
        if tick % 100 == 0:
            self._outputs['vehicle_status'].publish(messages.VehicleStatus(nav_state=OFFBOARD, arming_state=2, system_id=1))

    def _send_bearing(self, azimuth: float) -> None:
        self.bearings += 1
        now, stamp = time.monotonic(), to_stamp(time.time())
        self._sent_at = {'gimbal': now, 'body': now}
        self._bearings.publish(Bearing(
            header=Header(stamp=stamp), measured=stamp, state=Bearing.STATE_VISUAL_ACTIVE, azimuth=azimuth,
            azimuth_world=azimuth + math.pi / 2.0, elevation=0.1, elevation_variance=0.01, azimuth_variance=0.01))

    def _on_command(self, message: Any) -> None:
        self._outputs['vehicle_command_ack'].publish(self._messages.VehicleCommandAck(
            command=message.command, target_system=1, target_component=message.source_component))
        if message.command == GIMBAL_PITCH_YAW:
            self._record('gimbal')

    def _on_setpoint(self, _: Any) -> None:
        self._record('body')

    def _record(self, name: str) -> None:
        sent_at, self._sent_at[name] = self._sent_at[name], None
        if sent_at is not None:
            self.latencies[name].append(time.monotonic() - sent_at)


def main() -> None:
    """Print a table of latencies; exit code 1 if a 95th percentile is not below LIMIT_MS."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0, help='duration of the measurement (default: %(default)s)')
    parser.add_argument('--rate', type=float, default=50.0, help='bearings a second (default: %(default)s)')
    options = parser.parse_args()
    try:
        messages = load_px4_msgs()
    except ImportError as error:
        sys.exit(f'px4_latency: {error}')
    os.environ['ROS_DOMAIN_ID'] = str(100 + os.getpid() % 2)    # isolated from other ROS 2 nodes on the network
    nodes = [subprocess.Popen([sys.executable, '-c', f'from {module} import main; main()', '--ros-args', *arguments])
             for module, arguments in NODES.items()]
    try:
        rclpy.init()
        probe = LatencyProbe(messages)
        probe.run(options.seconds, options.rate)
    finally:
        for node in nodes:
            node.send_signal(signal.SIGINT)
        for node in nodes:
            node.wait(10.0)
        rclpy.try_shutdown()
    print(f'{options.rate:.0f} bearings a second, {options.seconds:.0f} s')
    print(f'{"from a bearing to the command for":34}{"median":>8}{"95 %":>8}{"99 %":>8}{"most":>8} ms   answered')
    worst = 0.0
    for name, latencies in probe.latencies.items():
        figures = 1e3 * np.percentile(latencies, [50, 95, 99, 100])
        print(f'{name:34}' + ''.join(f'{value:8.2f}' for value in figures) + f'      {len(latencies)} of {probe.bearings}')
        worst = max(worst, float(figures[1]))
    sys.exit(worst >= LIMIT_MS)


if __name__ == '__main__':
    main()
