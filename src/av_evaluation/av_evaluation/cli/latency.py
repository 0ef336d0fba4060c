"""`ros2 run av_evaluation latency [SECTION ...]`: delay and processor time of the rig's nodes, each in a process of its own.

hearing   from a block of sound to the direction that it completes: doa_node
px4       from a bearing to PX4's gimbal and body: pointing_node, px4_node; needs px4_msgs, see docs/reference/px4.md
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from std_msgs.msg import Header

from av_audio.messages import audio_frame
from av_common.node import Executor
from av_common.qos import RESULT, STREAM
from av_common.stamps import to_stamp
from av_evaluation.figures import Figure, print_sections
from av_evaluation.hearing.free_field import PAIR
from av_evaluation.hearing.signals import RATE, add_noise, flat
from av_interfaces.msg import AudioFrame, Bearing, DoaArray
from av_px4.commands import GIMBAL_PITCH_YAW
from av_px4.handover import OFFBOARD
from av_px4.nodes.px4_link import PX4_QOS, load_px4_msgs

START_S = 8.0       # in which the nodes start
HOP_S = 0.05        # of doa_node
VEHICLE_HZ = 100.0  # of PX4's attitude and position
HOLD, HANDED_OVER_S = 4, 6.0   # PX4's mode before OFFBOARD, and when the pilot selects that
MOST_CPU = 10.0     # % of a core, of doa_node


class Probe(Node):
    """Publishes inputs at a rate and measures the delays of the answers to each.

    Attributes:
        delays (s): measured, by the name of the answer.
        sent: number of inputs.

    Parameters:
        rate (Hz): of the inputs.
    """

    def __init__(self, rate: float) -> None:
        super().__init__(f'latency_{os.getpid()}')
        self._random, self.sent = np.random.default_rng(1), 0
        self._sent_at: dict[str, float] = {}
        self.delays: dict[str, list[float]] = {}
        self.create_timer(1.0 / rate, self._tick)

    def _send(self) -> None:
        """Publish one input."""
        raise NotImplementedError

    def _tick(self) -> None:
        self._sent_at = dict.fromkeys(self.delays, time.perf_counter())
        self.sent += 1
        self._send()

    def _answered(self, name: str, _: object = None) -> None:
        if (begun := self._sent_at.pop(name, None)) is not None:
            self.delays[name].append(time.perf_counter() - begun)

    def forget(self) -> None:
        """Begin again: what was measured while the nodes started does not count."""
        self.sent = 0
        for delays in self.delays.values():
            delays.clear()


class SoundProbe(Probe):
    """Noise from a direction, in blocks of a hop."""

    def __init__(self, rate: float) -> None:
        super().__init__(rate)
        self.delays['direction'] = []
        sound = add_noise(self._random, flat(self._random, 5.0, np.array([0.0, 2e-4])), 10.0).astype(np.float32)
        self._blocks, self._length = np.split(sound, round(5.0 * rate)), round(RATE / rate)
        self._publisher, self._first = self.create_publisher(AudioFrame, 'audio/frames', STREAM), 0
        self.create_subscription(DoaArray, 'doa', partial(self._answered, 'direction'), STREAM)

    def _send(self) -> None:
        header = Header(stamp=to_stamp(time.time() - self._length / RATE), frame_id='microphones')
        block = self._blocks[self._first // self._length % len(self._blocks)]
        self._publisher.publish(audio_frame(block, self._first, RATE, header))
        self._first += self._length


class BearingProbe(Probe):
    """Bearings, beside an armed vehicle that acknowledges every command at once; its pilot selects OFFBOARD."""

    def __init__(self, rate: float) -> None:
        super().__init__(rate)
        self.delays |= {'gimbal': [], 'body': []}
        self._messages: Any = load_px4_msgs()
        self._bearings = self.create_publisher(Bearing, 'target/bearing', RESULT)
        self._vehicle = {name: self.create_publisher(*self._topic('out', name, kind), PX4_QOS) for name, kind in (
            ('vehicle_status', 'VehicleStatus'), ('vehicle_attitude', 'VehicleAttitude'),
            ('vehicle_local_position', 'VehicleLocalPosition'), ('vehicle_command_ack', 'VehicleCommandAck'))}
        answers: dict[tuple[str, str], Callable[[Any], None]] = {
            ('vehicle_command', 'VehicleCommand'): self._on_command,
            ('offboard_control_mode', 'OffboardControlMode'): lambda _: None,
            ('trajectory_setpoint', 'TrajectorySetpoint'): partial(self._answered, 'body')}
        for names, take in answers.items():
            self.create_subscription(*self._topic('in', *names), take, PX4_QOS)
        self._ticks = 0
        self.create_timer(1.0 / VEHICLE_HZ, self._fly)

    def _topic(self, side: str, name: str, kind: str) -> tuple[type, str]:
        message = getattr(self._messages, kind)
        version = getattr(message, 'MESSAGE_VERSION', 0)
        return message, f'fmu/{side}/{name}' + (f'_v{version}' if version else '')

    def _fly(self) -> None:
        messages, level = self._messages, [1.0, 0.0, 0.0, 0.0]
        self._ticks += 1
        self._vehicle['vehicle_attitude'].publish(messages.VehicleAttitude(timestamp_sample=10_000 * self._ticks, q=level))
        self._vehicle['vehicle_local_position'].publish(messages.VehicleLocalPosition(xy_valid=True, z_valid=True))
        if self._ticks % 50 == 0:
            mode = HOLD if self._ticks < HANDED_OVER_S * VEHICLE_HZ else OFFBOARD
            status = messages.VehicleStatus(nav_state=mode, nav_state_user_intention=mode, arming_state=2, system_id=1)
            self._vehicle['vehicle_status'].publish(status)

    def _send(self) -> None:
        stamp, azimuth = to_stamp(time.time()), math.radians(20.0) * math.sin(time.time())
        self._bearings.publish(Bearing(
            header=Header(stamp=stamp), measured=stamp, state=Bearing.STATE_VISUAL_ACTIVE, azimuth=azimuth,
            azimuth_world=azimuth + math.pi / 2.0, elevation=0.1, elevation_variance=0.01, azimuth_variance=0.01))

    def _on_command(self, message: Any) -> None:
        self._vehicle['vehicle_command_ack'].publish(self._messages.VehicleCommandAck(
            command=message.command, target_system=1, target_component=message.source_component))
        if message.command == GIMBAL_PITCH_YAW:
            self._answered('gimbal')


def measure(make: Callable[[], Probe], nodes: Mapping[str, Sequence[str]], seconds: float, most_ms: float,
            most_cpu: float | None = MOST_CPU) -> Iterator[Figure]:
    """Delays, and the processor time of each node. Raises ImportError where messages are missing.

    Parameters:
        make: makes the probe.
        nodes: parameters of the nodes, by names such as `av_fusion.nodes.fusion_node`.
        seconds (s): to measure.
        most_ms (ms): bound of the 95th percentile of the delays.
        most_cpu (%): bound of the processor time of each node, of a core; None without.
    """
    with ExitStack() as opened:
        rclpy.init(args=[])
        opened.callback(rclpy.shutdown)
        probe, executor = make(), Executor()
        executor.add_node(probe)
        processes = {name.rpartition('.')[2]: _start(name, parameters, opened) for name, parameters in nodes.items()}
        _spin(executor, START_S)
        probe.forget()
        before, begun = {name: _cpu_seconds(process.pid) for name, process in processes.items()}, time.monotonic()
        _spin(executor, seconds)
        lasted = time.monotonic() - begun
        shares = {name: 100.0 * (_cpu_seconds(process.pid) - before[name]) / lasted for name, process in processes.items()}
    for name, delays in probe.delays.items():
        median, most, worst = 1e3 * np.percentile(delays or [np.inf], [50, 95, 100])
        yield Figure(f'{name}: answered of {probe.sent}', 100.0 * len(delays) / max(probe.sent, 1), '%', at_least=50.0)
        yield Figure(f'{name}: median', median, 'ms')
        yield Figure(f'{name}: 95 % within', most, 'ms', most_ms)
        yield Figure(f'{name}: longest', worst, 'ms')
    for name, share in shares.items():
        yield Figure(f'{name}: of a core', share, '%', most_cpu)


def hearing(rate: float, seconds: float) -> Iterator[Figure]:
    """doa_node with the shipped settings; its hop sets the rate."""
    with tempfile.TemporaryDirectory() as folder:
        array = Path(folder, 'pair.yaml')
        PAIR.save(array)
        nodes = {'av_audio.nodes.doa_node': [f'array_file:={array}', f'hop:={HOP_S}']}
        yield from measure(lambda: SoundProbe(1.0 / HOP_S), nodes, seconds, 1e3 * HOP_S)


def px4(rate: float, seconds: float) -> Iterator[Figure]:
    """pointing_node and px4_node, `rate` (Hz) bearings a second."""
    nodes: dict[str, Sequence[str]] = {'av_pointing.nodes.pointing_node': ('enabled:=true',),
                                        'av_px4.nodes.px4_node': ('offboard:=true',)}
    yield from measure(lambda: BearingProbe(rate), nodes, seconds, 10.0, None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; returns 1 where one misses its bound."""
    parser = argparse.ArgumentParser(prog='latency', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('sections', nargs='*', metavar='SECTION', help='of hearing, px4 (default: all)')
    parser.add_argument('--rate', type=float, default=50.0, help='inputs of px4 a second (%(default)g)')
    parser.add_argument('--seconds', type=float, default=20.0, help=f'to measure for, after {START_S:g} s (%(default)g)')
    options = parser.parse_args(arguments)
    os.environ.setdefault('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    os.environ['ROS_DOMAIN_ID'] = str(100 + os.getpid() % 2)    # isolated from other ROS 2 nodes on the network
    given = options.rate, options.seconds
    sections = {'hearing': partial(hearing, *given), 'px4': partial(px4, *given)}
    return print_sections(parser, sections, options.sections)


def _start(name: str, parameters: Sequence[str], opened: ExitStack) -> subprocess.Popen:
    given = [word for parameter in parameters for word in ('-p', parameter)]
    process = subprocess.Popen([sys.executable, '-c', f'from {name} import main; main()', '--ros-args', *given])
    opened.callback(process.wait, 15.0)
    opened.callback(process.terminate)
    return process


def _cpu_seconds(process_id: int) -> float:
    """Processor time (s) of a process (Linux)."""
    fields = Path(f'/proc/{process_id}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _spin(executor: Executor, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)


if __name__ == '__main__':
    sys.exit(main())
