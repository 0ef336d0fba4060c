"""No message, request or timer ends a node; what was refused is counted and reported; programming errors stay loud."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from ros_domains import free_domain
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from av_common.guarded_node import decode
from av_common.node import RigNode

pytestmark = pytest.mark.system


class Listener(RigNode):
    """Refuses odometry of the year 0, and has a fault that a number triggers."""

    def __init__(self, **kwargs) -> None:
        self.taken: list[Odometry] = []
        super().__init__('listener', **kwargs)

    def activate(self) -> None:
        self.create_subscription(Odometry, 'odometry', self._on_odometry, 10)
        self.create_subscription(Float64, 'number', self._on_number, 10)

    def _on_odometry(self, message: Odometry) -> None:
        if not message.header.stamp.sec:
            raise ValueError('odometry of the year 0')
        self.taken.append(message)

    def _on_number(self, message: Float64) -> None:
        self.taken.append({}[message.data])


class Rig:
    """A node under test, another node that attacks it, and the executor of both."""

    def __init__(self, make=Listener, **kwargs) -> None:
        rclpy.init(domain_id=free_domain())
        self.executor = SingleThreadedExecutor()
        self.node, self.attacker = make(**kwargs), rclpy.create_node('attacker')
        self.executor.add_node(self.node)
        self.executor.add_node(self.attacker)

    def spin(self, until, seconds=8.0) -> None:
        end = time.monotonic() + seconds
        while not until() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert until()

    def publisher(self, kind, topic):
        publisher = self.attacker.create_publisher(kind, topic, 10)
        self.spin(publisher.get_subscription_count)
        return publisher

    def call(self, kind, name, request):
        client = self.attacker.create_client(kind, name)
        self.spin(client.service_is_ready)
        answer = client.call_async(request)
        self.spin(answer.done)
        return answer.result()

    def close(self) -> None:
        self.executor.shutdown()
        rclpy.try_shutdown()


@pytest.fixture
def rig():
    rig = Rig()
    rig.spin(lambda: rig.node.is_active)
    yield rig
    rig.close()


def malformed():
    """Bytes that are no CDR of an Odometry."""
    return [b'\0\1\0\0', b'\xff\xff\xff\xff', b'\0\1\0\0' + b'\xff' * 40, b'\0\1\0\0' + bytes(8) + b'\xff\xff\xff\x7f',
            bytes(700), b'\0\1\0\0' + bytes(2_000_000)]


def test_malformed_messages_are_refused_and_the_next_one_is_taken(rig):
    """They reach no callback, not even as zeros, and do not end the node."""
    publisher = rig.publisher(Odometry, 'odometry')
    good = Odometry()
    good.header.stamp.sec = 5
    for number, data in enumerate(malformed(), 1):
        publisher.publish(data)
        rig.spin(lambda wanted=number: rig.node.refused.counts.get('odometry') == wanted)
        publisher.publish(good)
        rig.spin(lambda wanted=number: len(rig.node.taken) == wanted)
    assert all(message == good for message in rig.node.taken)


def test_refused_messages_are_counted_and_named_in_diagnostics(rig):
    """WARN while recent, with topic and reason; the count stays."""
    seen: dict[str, DiagnosticStatus] = {}
    rig.attacker.create_subscription(
        DiagnosticArray, '/diagnostics', lambda message: seen.update({s.name: s for s in message.status}), 10)
    publisher = rig.publisher(Odometry, 'odometry')
    publisher.publish(Odometry())
    rig.spin(lambda: 'odometry refused: odometry of the year 0' in
             getattr(seen.get('listener: status'), 'message', ''))
    status = seen['listener: status']
    assert status.level == DiagnosticStatus.WARN
    assert {value.key: value.value for value in status.values}['odometry refused'] == '1'


def test_a_fault_of_the_program_is_raised_in_tests_and_counted_elsewhere(rig, monkeypatch):
    """Loud with AV_STRICT, which every test has; alive, with ERROR and a traceback, without."""
    publisher = rig.publisher(Float64, 'number')
    publisher.publish(Float64(data=1.0))
    with pytest.raises(KeyError):
        rig.spin(lambda: False, seconds=3.0)
    monkeypatch.delenv('AV_STRICT')
    publisher.publish(Float64(data=2.0))
    rig.spin(lambda: rig.node.refused.counts.get('number') == 1)
    assert rig.node.is_active


def test_what_was_queued_when_the_node_was_deactivated_is_not_called(rig):
    """The executor calls it, but what it uses no longer exists."""
    ticks = []
    timer = rig.node.create_timer(100.0, lambda: ticks.append(timer.reset()))
    (subscription,) = (entity for entity in rig.node.subscriptions if entity.topic_name.endswith('odometry'))
    message = Odometry()
    message.header.stamp.sec = 5

    def call_both():
        subscription.callback(serialize_message(message))
        timer.callback()
    call_both()
    assert len(ticks) == len(rig.node.taken) == 1
    rig.node.trigger_deactivate()
    call_both()
    rig.node.trigger_activate()
    call_both()
    assert len(ticks) == len(rig.node.taken) == 1
    assert not rig.node.refused.counts


@pytest.mark.parametrize(('transition', 'label'), [
    (Transition.TRANSITION_ACTIVATE, ''), (Transition.TRANSITION_CONFIGURE, ''), (200, ''), (0, 'no such transition'),
    (0, 'configure'), (Transition.TRANSITION_ON_DEACTIVATE_SUCCESS, ''), (0, 'x' * 10_000)])
def test_impossible_transitions_are_answered_with_no_success(rig, transition, label):
    """In the state active."""
    request = ChangeState.Request(transition=Transition(id=transition, label=label))
    assert not rig.call(ChangeState, '/listener/change_state', request).success
    assert rig.node.is_active


def test_configured_by_hand_while_it_tries_to_start():
    """The next attempt continues from the state that it finds."""
    class Absent(Listener):
        def configure(self) -> None:
            if not hasattr(self, 'plugged'):
                raise OSError('absent')

    rig = Rig(Absent)
    try:
        rig.spin(lambda: rig.node._problem)
        rig.node.plugged = True
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
        assert rig.call(ChangeState, '/listener/change_state', request).success
        rig.spin(lambda: rig.node.is_active)
        assert rig.node._state_machine.current_state[0] == State.PRIMARY_STATE_ACTIVE
    finally:
        rig.close()


def test_clocks_that_jump_or_lie_do_not_end_a_node():
    """Negative, near the end of stamps and with too many nanoseconds: refused. Forward and backward: followed."""
    rig = Rig(parameter_overrides=[Parameter('use_sim_time', value=True)])
    try:
        rig.spin(lambda: rig.node.is_active)
        ticks: list[float] = []
        rig.node.create_timer(0.1, lambda: ticks.append(rig.node.now()))
        publisher = rig.publisher(Clock, '/clock')
        for refused, (sec, nanosec) in enumerate([(-1, 0), (-2**31, 0), (2**31 - 1, 0), (5, 10**9), (5, 2**32 - 1)], 1):
            message = Clock()
            message.clock.sec, message.clock.nanosec = sec, nanosec
            publisher.publish(message)
            rig.spin(lambda wanted=refused: rig.node.refused.counts.get('/clock') == wanted)
        for sec in (100, 2**31 - 7200, 50, 1_700_000_000, 0, 10):
            for step in range(3):
                message = Clock()
                message.clock.sec = sec + step
                publisher.publish(message)
                rig.spin(lambda wanted=sec + step: abs(rig.node.now() - wanted) < 1e-3)
        assert ticks[-1] >= 11.0 and len(ticks) < 100  # no period is made up for
    finally:
        rig.close()


def test_parameters_that_cannot_be_used_are_answered_with_the_reason(rig):
    """Wrong types, values that are not finite, and megabytes; unknown types and names; read-only ones."""
    double, text = 3, 4
    values = {'autostart': ParameterValue(type=1, bool_value=False), 'use_sim_time': ParameterValue(type=1, bool_value=True),
              'diagnostic_updater.period': ParameterValue(type=double, double_value=float('nan')),
              'unknown': ParameterValue(type=text, string_value='x' * 1_000_000), 'autostart ': ParameterValue(type=200)}
    request = SetParameters.Request(parameters=[ParameterMessage(name=name, value=value) for name, value in values.items()])
    answer = rig.call(SetParameters, '/listener/set_parameters', request)
    assert len(answer.results) == len(values)
    assert not any(result.successful for result in answer.results) and all(result.reason for result in answer.results)
    assert rig.node.is_active


def test_whatever_a_node_makes_is_destroyed_with_the_state_it_was_made_in():
    """Entities made in configure end with cleanup, those of activate and of callbacks with deactivate."""
    class Maker(Listener):
        def configure(self) -> None:
            self._output = self.create_publisher(Odometry, 'made', 10)
            self.create_subscription(Odometry, 'made', lambda _: None, 10)

        def activate(self) -> None:
            self.create_service(ChangeState, 'service', lambda _, response: response)
            self.create_timer(1.0, lambda: None)

        def deactivate(self) -> None:
            self._output.publish(Odometry())  # its publishers are still there

    rig = Rig(Maker, parameter_overrides=[Parameter('autostart', value=False)])
    try:
        before = set(rig.node.entities())
        for _ in range(5):
            rig.node.trigger_configure()
            configured = set(rig.node.entities())
            assert len(configured - before) == 2
            rig.node.trigger_activate()
            rig.node.create_subscription(Odometry, 'made', lambda _: None, 10)
            assert len(set(rig.node.entities()) - configured) == 3
            rig.node.trigger_deactivate()
            assert set(rig.node.entities()) == configured
            rig.node.trigger_cleanup()
            assert set(rig.node.entities()) == before
    finally:
        rig.close()


def test_a_reader_takes_the_newest_when_it_looks_and_wakes_nobody(rig):
    """Messages wait in the middleware by the depth of the queue, with the time of their publishing; nothing is left of it."""
    before = rig.node.entities()
    reader = rig.node.create_reader(Float64, 'looked_at', QoSProfile(depth=2))
    assert reader.subscription not in rig.node.subscriptions and reader.subscription in rig.node.entities()
    publisher = rig.publisher(Float64, 'looked_at')
    begin = time.time()
    for value in (1.0, 2.0, 3.0):
        publisher.publish(Float64(data=value))
    found = []
    rig.spin(lambda: found.extend(reader.take()) or len(found) >= 2)
    assert [decode(Float64, data).data for data, _ in found] == [2.0, 3.0] and reader.take() == []
    assert all(begin - 1.0 < published <= time.time() for _, published in found)
    assert rig.node.taken == [] and not rig.node.refused.counts
    rig.node.destroy_entities([reader.subscription])
    assert rig.node.entities() == before


PROCESS = """
import sys
from av_common.node import RigNode, run

class Faulty(RigNode):
    def __init__(self):
        super().__init__('faulty')
    def activate(self):
        self.get_logger().info('active')
        self.create_timer(0.05, self._tick)
        broken = self.create_service(Empty, 'broken', lambda request, response: response)
        broken.srv_type = int  # the middleware raises before the callback
        self.client = self.create_client(Empty, 'broken')
        self.fault = sys.argv[1]
        self.ticks = 0
    def _tick(self):
        self.ticks += 1
        if self.fault == 'program':
            {}[self.ticks]
        self.client.call_async(Empty.Request())
        if self.ticks == 40:
            print('alive', self.refused.counts['middleware'] > 2, flush=True)
            self.finish()

from std_srvs.srv import Empty
run(Faulty)
"""


@pytest.mark.parametrize(('fault', 'strict', 'code'), [('middleware', '', 0), ('program', '1', 1)])
def test_a_process_outlives_errors_of_the_middleware_but_no_fault_in_tests(fault, strict, code):
    """What a take raises in the executor, before any callback, is counted; a fault ends a strict process with its traceback."""
    result = subprocess.run([sys.executable, '-c', PROCESS, fault], capture_output=True, text=True, timeout=60.0,
                            env={**os.environ, 'ROS_DOMAIN_ID': str(free_domain()), 'AV_STRICT': strict})
    assert result.returncode == code, result.stderr
    assert 'alive True' in result.stdout if not code else 'KeyError' in result.stderr, result.stderr
    assert result.returncode != -signal.SIGSEGV
