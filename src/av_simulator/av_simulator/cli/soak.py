"""`ros2 run av_simulator soak`: stream a scenario through the bridge for an hour, without lost samples or memory growth."""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from av_common.qos import RESULT
from av_interfaces.msg import AudioFrame
from av_sim_bridge.wire.ports import Ports
from av_simulator.cli.arguments import not_negative, port_offset, positive
from av_simulator.config_files import find_config
from av_simulator.run import BLOCKS_PER_SECOND

# Deeper than the rig's own QoS: a delay of this program must not count as a loss of the stream.
DEEP = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
NAMESPACE = f'soak_{os.getpid()}'    # allows several runs at a time
SAMPLE_RATE = 48_000   # Hz
SETTLED = 0.2          # fraction of the run after which memory must not grow: all buffers have then been filled
PATIENCE = 60.0        # s without data after which the run is aborted
# Counters of the bridge that must stay 0 on the loopback interface.
LOSSES = ('audio lost', 'audio lost frames', 'audio overwritten frames', 'audio malformed', 'audio foreign')


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(prog='soak', description=__doc__)
    parser.add_argument('scenario', nargs='?', default='fog_woodland',
                        help='name of a shipped scenario, or a YAML file (default: %(default)s)')
    parser.add_argument('--duration', type=positive, default=3600.0, help='duration in seconds (default: %(default)s)')
    parser.add_argument('--every', type=positive, default=60.0, help='seconds between status lines (default: %(default)s)')
    parser.add_argument('--image-rate', type=not_negative, default=15.0, help='images a second (default: %(default)s)')
    parser.add_argument('--renderer', choices=['auto', 'scene', 'flat'], default='flat',
                        help='renderer of the images (default: %(default)s)')
    parser.add_argument('--most-growth', type=positive, default=3.0,
                        help='maximum growth of memory in MiB (default: %(default)s)')
    parser.add_argument('--port-offset', type=port_offset, default=200, help='added to every port (default: %(default)s)')
    return parser.parse_args(arguments)


@dataclass
class Memory:
    """Resident memory of a process over time.

    Parameters:
        process: the process.
        samples (MiB): measurements so far.
    """

    process: subprocess.Popen
    samples: list[float] = field(default_factory=list)

    def take(self) -> None:
        """Add one measurement, unless the process has ended."""
        lines = Path(f'/proc/{self.process.pid}/status').read_text().splitlines()
        self.samples += [int(line.split()[1]) / 1024 for line in lines if line.startswith('VmRSS')]

    @property
    def growth(self) -> float:
        """Difference (MiB) between the medians of the first tenth after settling and of the last tenth."""
        settled = self.samples[int(SETTLED * len(self.samples)):]
        tenth = max(len(self.samples) // 10, 1)
        return float(np.median(settled[-tenth:]) - np.median(settled[:tenth]))


class LossMonitor(Node):
    """Subscribes to the bridge's audio, counts its gaps, and collects the losses reported in /diagnostics."""

    def __init__(self) -> None:
        super().__init__('loss_monitor', namespace=NAMESPACE)
        self.frames = self.gaps = 0
        self.counts: dict[str, str] = {}
        self.create_subscription(AudioFrame, 'audio/frames', self._on_sound, DEEP)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, RESULT)

    @property
    def lost(self) -> dict[str, int]:
        """Losses by name: the bridge's counters that are not 0, and the gaps between its messages."""
        return {name: int(self.counts[name]) for name in LOSSES if int(self.counts.get(name, 0))} | (
            {'gaps': self.gaps} if self.gaps else {})

    def _on_sound(self, message: AudioFrame) -> None:
        self.gaps += message.first_sample != self.frames
        self.frames = message.first_sample + len(message.samples) // message.channels

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(f'{NAMESPACE}/bridge_node'):
                self.counts = {value.key: value.value for value in status.values}


def main(arguments: list[str] | None = None) -> int:
    """Print status lines and the result. Returns the exit code: 0 without losses and memory growth, else 1."""
    options = parse(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)    # Ctrl-C is a KeyboardInterrupt here
    monitor = LossMonitor()
    processes: list[subprocess.Popen] = []
    try:
        processes.append(_start_bridge(options))
        _wait(monitor, lambda: 'audio rate (Hz)' in monitor.counts, processes, 'the bridge did not start')
        processes.append(_start_simulator(options))
        bridge, simulator = map(Memory, processes)
        return _watch(monitor, bridge, simulator, options)
    except (RuntimeError, KeyboardInterrupt) as error:
        print(f'soak: {str(error) or "interrupted"}', file=sys.stderr)
        return 1
    finally:
        for process in processes:
            process.terminate()
            process.wait()
        monitor.destroy_node()
        rclpy.shutdown()


def _start_bridge(options: argparse.Namespace) -> subprocess.Popen:
    ports = asdict(Ports().shifted(options.port_offset))
    parameters = ['-p', f'rig_file:={find_config("rig")}']
    parameters += [text for name, port in ports.items() for text in ('-p', f'{name}_port:={port}')]
    return subprocess.Popen([sys.executable, '-m', 'av_sim_bridge.nodes.bridge_node', '--ros-args', '-r',
                             f'__ns:=/{NAMESPACE}', *parameters])


def _start_simulator(options: argparse.Namespace) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, '-m', 'av_simulator.cli.simulator', options.scenario, '--audio-header',
                             '--port-offset', str(options.port_offset), '--duration', str(options.duration),
                             '--image-rate', str(options.image_rate), '--renderer', options.renderer])


def _watch(monitor: LossMonitor, bridge: Memory, simulator: Memory, options: argparse.Namespace) -> int:
    expected = math.ceil(options.duration * BLOCKS_PER_SECOND) * SAMPLE_RATE // BLOCKS_PER_SECOND
    began = shown = received_at = time.monotonic()
    received = 0
    while monitor.frames < expected:
        _spin(monitor, 1.0)
        now = time.monotonic()
        if monitor.frames > received:
            received, received_at = monitor.frames, now
        bridge.take()
        simulator.take()
        if bridge.process.poll() is not None or simulator.process.poll() not in (None, 0):
            raise RuntimeError('a process has ended')
        if now - received_at > PATIENCE:
            break
        if now - shown >= options.every:
            shown = now
            print(f'{now - began:7.0f} s: {received} frames, lost {monitor.lost or "none"}; resident memory: bridge '
                  f'{bridge.samples[-1]:.1f}, simulator {simulator.samples[-1]:.1f} MiB', flush=True)
    monitor.counts = {}    # the counts may be a second old: wait for the next ones
    _wait(monitor, lambda: bool(monitor.counts), [bridge.process], 'no diagnostics from the bridge')
    return _verdict(monitor, expected, {'bridge': bridge, 'simulator': simulator}, options.most_growth)


def _verdict(monitor: LossMonitor, expected: int, memories: dict[str, Memory], most_growth: float) -> int:
    complete = monitor.frames == expected and not monitor.lost
    print(f'{monitor.frames} of {expected} frames, lost {monitor.lost or "none"}: {"holds" if complete else "MISSED"}')
    steady = True
    for name, memory in memories.items():
        kept = memory.growth <= most_growth
        steady &= kept
        print(f'{name}: {memory.samples[-1]:.1f} MiB, grown by {memory.growth:+.2f} MiB since {SETTLED:.0%} of the run '
              f'(<= {most_growth:g}): {"holds" if kept else "MISSED"}')
    return 0 if complete and steady else 1


def _spin(monitor: LossMonitor, seconds: float) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        rclpy.spin_once(monitor, timeout_sec=left)


def _wait(monitor: LossMonitor, condition: Callable[[], bool], processes: list[subprocess.Popen], error: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end or any(process.poll() is not None for process in processes):
            raise RuntimeError(error)
        _spin(monitor, 0.2)


if __name__ == '__main__':
    sys.exit(main())
