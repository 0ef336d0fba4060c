"""The base of the nodes: starts by itself, survives what fails, says so, and ends cleanly."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from ros_domains import free_domain

from av_common.launched import BEAT_PERIOD_S, HUNG, RUN_FOLDER, started_file
from av_common.node import RigNode
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds, to_stamp

pytestmark = pytest.mark.system


class Sensor(RigNode):
    """A node whose sensor can be absent."""

    def __init__(self, plugged: bool) -> None:
        self.plugged, self.ticks = plugged, 0
        super().__init__('sensor')

    def activate(self) -> None:
        if not self.plugged:
            raise OSError('sensor not plugged in')
        self.create_timer(0.02, self._tick)

    def _tick(self) -> None:
        self.ticks += 1


@pytest.fixture
def executor():
    """rclpy, up and down again."""
    rclpy.init(domain_id=free_domain())
    executor = SingleThreadedExecutor()
    yield executor
    executor.shutdown()
    rclpy.try_shutdown()


def spin(executor, until, seconds=6.0):
    """Spin until a condition holds."""
    clock = executor.context and RateMeter()
    clock.tick()
    while not until() and clock.age < seconds:
        executor.spin_once(timeout_sec=0.05)
    assert until()


def test_starts_stops_and_starts_again(executor):
    """Activates by itself; timers made while active stop with it."""
    node = Sensor(plugged=True)
    executor.add_node(node)
    spin(executor, lambda: node.ticks > 3)
    node.trigger_deactivate()
    ticks = node.ticks
    for _ in range(10):
        executor.spin_once(timeout_sec=0.03)
    assert node.ticks == ticks and not node.is_active
    node.trigger_activate()
    spin(executor, lambda: node.ticks > ticks)
    node.close()
    node.destroy_node()


@pytest.mark.parametrize(('simulated', 'kind'), [('false', ClockType.STEADY_TIME), ('true', ClockType.ROS_TIME)])
def test_timers_go_on_while_the_system_clock_is_set_back(simulated, kind):
    """Those of the node's clock would rest until it shows again what it showed; with simulated time they follow that."""
    rclpy.init(args=['--ros-args', '-p', f'use_sim_time:={simulated}'], domain_id=free_domain())
    try:
        node = Sensor(plugged=True)
        assert node.create_timer(1.0, node._tick).clock.clock_type == kind
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_an_absent_sensor_is_reported_and_found_later(executor):
    """Not plugged in: alive, /diagnostics says ERROR and why; plugged in: works within seconds."""
    node, seen = Sensor(plugged=False), []
    listener = rclpy.create_node('listener')
    listener.create_subscription(DiagnosticArray, '/diagnostics', lambda message: seen.extend(message.status), 10)
    executor.add_node(node)
    executor.add_node(listener)
    spin(executor, lambda: any('not plugged in' in status.message for status in seen))
    bad = next(status for status in seen if 'not plugged in' in status.message)
    assert bad.level == DiagnosticStatus.ERROR and bad.name == 'sensor: status'
    assert node._state_machine.current_state[0] == State.PRIMARY_STATE_UNCONFIGURED
    node.plugged = True
    spin(executor, lambda: node.ticks > 0)
    node.destroy_node()
    listener.destroy_node()


PROCESS = """
import sys, threading
from av_common.node import RigNode, run

class Idle(RigNode):
    def __init__(self):
        super().__init__('idle')
    def activate(self):
        print('active', flush=True)
        if sys.argv[1:] == ['done']:
            threading.Timer(0.2, self.finish).start()
    def deactivate(self):
        print('deactivated', self.context.ok(), flush=True)

run(Idle)
"""


@pytest.mark.parametrize('end', [signal.SIGINT, signal.SIGTERM, 'done'])
def test_a_process_ends_cleanly_though_nothing_happens(end):
    """By signal, or because its work is done: the node deactivates while the middleware is still there."""
    process = subprocess.Popen([sys.executable, '-c', PROCESS, str(end)], stdout=subprocess.PIPE, text=True,
                               env={**os.environ, 'ROS_DOMAIN_ID': str(free_domain())})
    assert process.stdout.readline() == 'active\n'
    if end != 'done':
        process.send_signal(end)
    rest, _ = process.communicate(timeout=30.0)
    assert rest == 'deactivated True\n' and process.returncode == 0


def test_signals_while_it_ends_change_nothing():
    """Ctrl-C reaches a node from the terminal and from its launch, at any time: no exit code tells of a crash."""
    process = subprocess.Popen([sys.executable, '-c', PROCESS], stdout=subprocess.PIPE, text=True,
                               env={**os.environ, 'ROS_DOMAIN_ID': str(free_domain())})
    assert process.stdout.readline() == 'active\n'
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.001)
    assert process.returncode == 0
    process.stdout.close()


def test_a_node_that_is_shut_down_ends_its_process():
    """By request: it answers, deactivates and ends well, so that a launch sees it; finalized nodes can do nothing."""
    domain = free_domain()
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
    process = subprocess.Popen([sys.executable, '-c', PROCESS, 'shutdown'], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout.readline() == 'active\n'
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    caller = rclpy.create_node('caller', context=context)
    client = caller.create_client(ChangeState, '/idle/change_state')
    assert client.wait_for_service(20.0)
    answer = client.call_async(ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(caller)
    executor.spin_until_future_complete(answer, 20.0)
    assert answer.result().success
    rest, _ = process.communicate(timeout=30.0)
    assert rest == 'deactivated True\n' and process.returncode == 0
    rclpy.shutdown(context=context)


def test_now_is_the_nodes_clock_in_seconds(executor):
    """Wall time here, simulated time with use_sim_time."""
    node = RigNode('clock', parameter_overrides=[Parameter('autostart', value=False)])
    assert node.now() == pytest.approx(time.time(), abs=5.0)
    node.destroy_node()


def test_stamps_round_trip_to_a_quarter_microsecond():
    """Today's epoch fits; what no stamp can hold is refused."""
    seconds = 1_795_000_000.123456789
    assert to_seconds(to_stamp(seconds)) == pytest.approx(seconds, abs=3e-7)
    assert to_stamp(1.9999999999) == to_stamp(2.0)
    for wrong in (-1.0, float('nan'), 1e12):
        with pytest.raises(ValueError, match='stamp'):
            to_stamp(wrong)


def test_rate_meter_counts_on_its_own_clock():
    """Rates over a window, ages since the newest."""
    now = [0.0]
    meter = RateMeter(lambda: now[0])
    assert meter.rate == 0.0 and meter.age == float('inf')
    for _ in range(100):
        now[0] += 0.1
        meter.tick()
    assert meter.rate == pytest.approx(10.0)
    now[0] += 1.5
    assert meter.age == pytest.approx(1.5) and meter.rate == pytest.approx(10.0)
    now[0] += 4.0
    assert meter.rate == 0.0, 'nothing came within the window'


def test_a_rate_that_another_thread_asks_for_forgets_nothing():
    """Both took the oldest for too old, and forgot two: an input that had just come had never been."""
    now, asked = [0.0], []
    meter = RateMeter(lambda: now[0])

    class Interrupted(deque):
        def popleft(self):
            if not asked:
                asked.append(meter.rate)
            return super().popleft()

    meter._arrivals = Interrupted()
    for now[0] in (0.0, 9.0):
        meter.tick()
    assert asked and meter.age == 0.0


def test_the_heartbeat_is_that_of_the_executor(executor, tmp_path, monkeypatch):
    """It goes on while callbacks are called, inactive or not, says when a transition may take long, and stands still else."""
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    busy, beats, file = [], [], started_file(tmp_path, os.getpid())

    class Slow(Sensor):
        def configure(self) -> None:
            busy.append(file.read_text())

    node = Slow(plugged=True)
    node.begin_heartbeat()
    executor.add_node(node)

    def changed():
        beat = file.read_text() if file.exists() else ''
        if beat and not beat.startswith('busy') and beat not in beats:
            beats.append(beat)
        return len(beats) > 3
    spin(executor, changed, 20.0)
    assert len(busy) == 1 and busy[0].startswith('busy')
    assert [float(beat) for beat in beats] == sorted(map(float, beats))
    time.sleep(2.5 * BEAT_PERIOD_S)
    assert file.read_text() == beats[-1]
    node.destroy_node()


def test_a_process_that_replaces_one_that_hung_says_so(executor, monkeypatch):
    monkeypatch.setenv(HUNG, '2')
    node = Sensor(plugged=True)
    status = node._diagnose(DiagnosticStatusWrapper())
    assert status.level == DiagnosticStatus.WARN and 'hung' in status.message
    assert {entry.key: entry.value for entry in status.values}['of them hung'] == '2'
    node.destroy_node()
