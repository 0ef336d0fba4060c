"""The node's addresses: what contradicts itself is refused, and who is refused appears in /diagnostics."""

import socket

import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('av_sim_bridge.nodes.bridge_node_parameters', reason='needs the built workspace')

from bridge_rig import RIG  # noqa: E402
from diagnostic_updater import DiagnosticStatusWrapper  # noqa: E402
from udp_ports import free_offset  # noqa: E402

from av_sim_bridge.nodes.bridge_node import BridgeNode  # noqa: E402
from av_sim_bridge.receiving.receiver import Receiver  # noqa: E402
from av_sim_bridge.wire.oracle import OracleBox, encode_oracle  # noqa: E402
from av_sim_bridge.wire.ports import Ports  # noqa: E402

pytestmark = pytest.mark.system


@pytest.fixture
def make_node():
    """A function from parameters to a node that is configured and activated by hand."""
    nodes = []

    def make(**parameters):
        offset = free_offset(parameters.get('targets', 1))
        settings = {'port_offset': offset, 'rig_file': RIG, 'oracle_detections': 'true', 'autostart': 'false', **parameters}
        rclpy.init(args=['--ros-args', *(text for name, value in settings.items() for text in ('-p', f'{name}:={value}'))])
        nodes.append(BridgeNode())
        return nodes[-1], Ports().shifted(offset)

    yield make
    for node in nodes:
        node.close()
        node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize(('parameters', 'complaint'), [
    ({'bind_address': '0.0.0.0'}, 'bind_address is 0.0.0.0, which other machines reach, but allowed_senders is 127.0.0.0/8'),
    ({'allowed_senders': '[192.168.1.20]'}, 'allowed_senders is 192.168.1.20, but bind_address 127.0.0.1'),
    ({'allowed_senders': '[here]'}, "allowed_senders has 'here'"),
    ({'control_host': '192.168.1.20'}, 'control_host is 192.168.1.20, which cannot be reached from bind_address 127.0.0.1'),
    ({'control_host': 'no.such.host.invalid'}, "control_host is 'no.such.host.invalid'")])
def test_addresses_that_contradict_each_other_are_refused(make_node, parameters, complaint):
    node, _ = make_node(**parameters)
    node.trigger_configure()
    assert complaint in node._problem


def test_an_address_of_another_machine_is_named(make_node):
    node, ports = make_node(bind_address='192.0.2.77', allowed_senders='[192.0.2.78]')
    node.trigger_configure()
    node.trigger_activate()
    assert f'audio: cannot receive on UDP port {ports.audio} of 192.0.2.77' in node._problem


def test_the_refused_are_counted_and_named(make_node):
    node, ports = make_node(allowed_senders="['127.0.0.1:9']")
    node.trigger_configure()
    node.trigger_activate()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
        for _ in range(5):
            source.sendto(encode_oracle([OracleBox(2, 0.9, 0.0, 0.0, 10.0, 10.0)]), ('127.0.0.1', ports.image))
    for _ in range(500):
        if node._refusals.total == 5:
            break
        node._receivers['image']._thread.join(0.01)
    first, second = DiagnosticStatusWrapper(), DiagnosticStatusWrapper()
    node.diagnose(first)
    node.diagnose(second)
    values = {entry.key: entry.value for entry in first.values}
    assert (values['refused datagrams'], values['refused senders']) == ('5', '127.0.0.1: 5')
    assert values['image malformed'] == '0'
    assert 'datagrams of 127.0.0.1 refused: not in allowed_senders' in first.message
    assert 'refused' not in second.message    # none since


def test_the_threads_of_many_ports_end_together(make_node, monkeypatch):
    """All are told to before the first is waited for: each alone may take 0.2 s."""
    node, _ = make_node(targets=32)
    node.trigger_configure()
    node.trigger_activate()
    receivers, told, stop = list(node._receivers.values()), set(), Receiver.stop

    def stop_noting(receiver):
        told.add(sum(each._ending for each in receivers))
        stop(receiver)

    monkeypatch.setattr(Receiver, 'stop', stop_noting)
    for receiver in receivers:    # the callbacks were bound before
        node._opened.callback(receiver.stop)
    node.close()
    assert len(receivers) > 36 and told == {len(receivers)}
    assert not any(receiver._thread.is_alive() for receiver in receivers)
