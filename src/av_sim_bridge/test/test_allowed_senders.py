"""Who may send: parsing, the sockets of two hosts, counts of the refused, and floods."""

import socket
import struct
import threading
import time

import pytest
from network_hosts import OTHER, RIG, STRANGER, two_hosts

from av_sim_bridge.receiving.allowed_senders import AllowedSenders, Refusals, SenderGate, resolve
from av_sim_bridge.receiving.receiver import Receiver, open_port
from av_sim_bridge.wire.ports import TIME_SYNC_GROUP


@pytest.mark.parametrize(('entries', 'sender', 'accepted'), [
    (['127.0.0.0/8'], ('127.0.0.1', 5), True), (['127.0.0.0/8'], ('192.168.1.20', 5), False),
    (['192.168.1.20'], ('192.168.1.20', 5), True), (['192.168.1.20'], ('192.168.1.21', 5), False),
    (['192.168.1.20:30100'], ('192.168.1.20', 30_100), True), (['192.168.1.20:30100'], ('192.168.1.20', 30_101), False),
    (['10.0.0.0/30', '192.168.1.0/24'], ('192.168.1.255', 1), True), (['10.0.0.0/30'], ('10.0.0.4', 1), False),
    (['', ' 10.0.0.1 '], ('10.0.0.1', 1), True), ([], ('127.0.0.1', 1), False), (['0.0.0.0/0'], ('8.8.8.8', 1), True)])
def test_addresses_networks_and_ports(entries, sender, accepted):
    assert (sender in AllowedSenders(entries)) == accepted


@pytest.mark.parametrize('entry', ['simulator', '192.168.1', '192.168.1.20/24', '1.2.3.4:', '1.2.3.4:0', '1.2.3.4:70000',
                                   '1.2.3.4:x', '::1', '300.1.1.1', '10.0.0.0/33', '9' * 400])
def test_what_is_no_sender_is_named(entry):
    with pytest.raises(ValueError, match='allowed_senders has .*expected an IPv4 address or network'):
        AllowedSenders(['127.0.0.1', entry])


def test_too_many_entries_are_refused():
    with pytest.raises(ValueError, match='65 entries, expected at most 64'):
        AllowedSenders(['10.0.0.1'] * 65)


@pytest.mark.parametrize(('address', 'entries', 'complaint'), [
    ('0.0.0.0', [], 'bind_address is 0.0.0.0, which other machines reach, but allowed_senders is nobody'),
    ('0.0.0.0', ['127.0.0.0/8'], 'allowed_senders is 127.0.0.0/8, expected the address of the machine that sends'),
    ('192.168.1.5', ['127.0.0.1'], 'bind_address is 192.168.1.5'),
    ('127.0.0.1', ['192.168.1.20'], 'bind_address 127.0.0.1 receives from this machine only'),
    ('127.0.0.1', ['0.0.0.0/0'], 'receives from this machine only'),
    ('', ['127.0.0.1'], "bind_address is '', expected an IPv4 address"), ('localhost', ['127.0.0.1'], 'bind_address')])
def test_addresses_that_contradict_each_other_are_refused(address, entries, complaint):
    with pytest.raises(ValueError, match=complaint):
        AllowedSenders(entries).check_bind_address(address)


@pytest.mark.parametrize(('address', 'entries'), [
    ('127.0.0.1', ['127.0.0.0/8']), ('127.0.0.1', []), ('0.0.0.0', ['192.168.1.20']), ('192.168.1.5', ['192.168.1.0/24'])])
def test_addresses_that_agree(address, entries):
    AllowedSenders(entries).check_bind_address(address)


def test_a_host_that_is_not_known_is_named():
    assert resolve('control_host', '127.0.0.1') == '127.0.0.1'
    for host in ('no.such.host.invalid', 'x' * 300, 'a..b'):
        with pytest.raises(ValueError, match='control_host is'):
            resolve('control_host', host)


def test_the_table_of_the_refused_is_bounded():
    refusals = Refusals(most=3)
    for number in range(100):
        refusals.add((f'10.0.0.{number}', 5))
    refusals.add(('10.0.0.98', 6))
    assert refusals.total == 101
    assert refusals.counts() == {'10.0.0.98': 2, '10.0.0.99': 1, '10.0.0.97': 1}
    assert next(iter(refusals.counts())) == '10.0.0.98'


class Port:
    """A receiver behind a gate; `taken` holds the datagrams and their senders."""

    def __init__(self, allowed, address='127.0.0.1', group=None, port=0):
        self.taken, self.refusals = [], Refusals()
        source = open_port('some_port', port, 1 << 20, address, group)
        self.receiver = Receiver('some', source, lambda datagram, _, sender: self.taken.append((datagram, sender)),
                                 SenderGate(source, AllowedSenders(allowed), self.refusals))
        self.number = self.receiver.port

    def wait(self, condition, seconds=30.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.01)


def sender_at(address):
    source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    source.bind((address, 0))
    return source


def test_only_the_allowed_are_received_from_another_host():
    with two_hosts() as (rig, other):
        port = rig.run(Port, [OTHER], '0.0.0.0')
        for address in (STRANGER, OTHER, STRANGER):
            source = other.run(sender_at, address)
            source.sendto(address.encode(), (RIG, port.number))
        port.wait(lambda: port.taken and port.refusals.total == 2)
        port.receiver.stop()
        assert [datagram for datagram, _ in port.taken] == [OTHER.encode()]
        assert port.refusals.counts() == {STRANGER: 2}


def test_by_default_nothing_comes_from_another_host():
    with two_hosts() as (rig, other):
        port = rig.run(Port, ['127.0.0.0/8'])
        source, local = other.run(sender_at, OTHER), rig.run(sender_at, '127.0.0.1')
        source.sendto(b'from outside', (RIG, port.number))
        local.sendto(b'from here', ('127.0.0.1', port.number))
        port.wait(lambda: port.taken)
        port.receiver.stop()
        assert [datagram for datagram, _ in port.taken] == [b'from here'] and port.refusals.total == 0


@pytest.mark.parametrize('address', ['127.0.0.1', RIG, '0.0.0.0'])
def test_the_multicast_group_is_received_in_the_network_of_the_address(address):
    """A datagram to the port but not to the group is not received at all."""
    with two_hosts() as (rig, other):
        host, sender = (rig, '127.0.0.1') if address == '127.0.0.1' else (other, OTHER)
        port = rig.run(Port, [sender], address, TIME_SYNC_GROUP, 20_005)
        source = host.run(sender_at, sender)
        source.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(sender))
        source.sendto(b'past it', (address if address != '0.0.0.0' else RIG, port.number))
        source.sendto(b'tick', (TIME_SYNC_GROUP, port.number))
        port.wait(lambda: port.taken)
        port.receiver.stop()
        assert [datagram for datagram, _ in port.taken] == [b'tick']


@pytest.mark.parametrize('entries', [[f'{OTHER}:5001'], ['10.0.0.0/30', OTHER], ['10.77.0.2/32', '10.0.0.1:7']])
def test_the_kernel_accepts_the_same_senders(entries):
    with two_hosts() as (rig, other):
        port = rig.run(Port, entries, '0.0.0.0')
        gate = port.receiver._gate
        gate.renew()
        gate._until = time.monotonic() + 60.0
        gate._filter(True)
        assert gate._filtered
        for address, number in ((STRANGER, 5001), (OTHER, 5001)):
            source = other.run(sender_at, address)
            source.close()
            source = other.run(lambda address=address, number=number: bound(address, number))
            source.sendto(address.encode(), (RIG, port.number))
        port.wait(lambda: port.taken)
        port.receiver.stop()
        assert [datagram for datagram, _ in port.taken] == [OTHER.encode()] and port.refusals.total == 0


def bound(address, number):
    source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    source.bind((address, number))
    return source


def test_a_flood_of_the_refused_delays_nothing(monkeypatch):
    """Of the allowed one arrives what the network itself does not lose, and the refused are few to look at."""
    monkeypatch.setattr(SenderGate, 'PERIOD', 60.0)
    with two_hosts() as (rig, other):
        port = rig.run(Port, [OTHER], '0.0.0.0')
        flooding, sent = True, 0

        def flood():
            nonlocal sent
            source = other.run(sender_at, STRANGER)
            while flooding:
                for _ in range(100):
                    source.sendto(bytes(1400), (RIG, port.number))
                sent += 100
                time.sleep(0.002)

        thread = threading.Thread(target=flood)
        thread.start()
        port.wait(lambda: port.receiver._gate._filtered and sent > 1000)
        source = other.run(sender_at, OTHER)
        while not port.taken:    # until what the flood left in the buffer is gone
            source.sendto(struct.pack('<i', 0), (RIG, port.number))
            time.sleep(0.05)
        for number in range(1, 101):
            source.sendto(struct.pack('<i', number), (RIG, port.number))
            time.sleep(0.01)
        port.wait(lambda: port.taken[-1][0] == struct.pack('<i', 100))
        refused, sent_until_then = port.refusals.total, sent
        port.wait(lambda: sent > sent_until_then + 1000)
        flooding = False
        thread.join()
        port.receiver.stop()
        assert len({datagram for datagram, _ in port.taken}) > 95
        assert SenderGate.MOST <= refused == port.refusals.total    # the rest is left to the kernel


def test_after_a_flood_the_refused_are_counted_as_before(monkeypatch):
    monkeypatch.setattr(SenderGate, 'MOST', 3)
    now = 0.0
    monkeypatch.setattr(time, 'monotonic', lambda: now)
    refusals = Refusals()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
        gate = SenderGate(source, AllowedSenders([]), refusals)
        filtered = []
        for now in (0.0, 0.9, 1.1, 2.0, 2.2, 3.3, 3.9, 4.4):
            gate.renew()
            filtered.append(gate._filtered)
            for _ in range(5 if now < 2.1 else 1):
                assert not gate.admits(('10.0.0.1', 5))
    assert filtered == [False, True, False, True, False, False, False, False]
    assert refusals.total == 4 * 5 + 4


def test_a_busy_port_and_a_foreign_address_name_the_parameter():
    blocker = open_port('audio_port', 0, 65_536)
    with pytest.raises(OSError, match=r'image_port: cannot receive on UDP port \d+ of 127.0.0.1: .*another program'):
        open_port('image_port', blocker.getsockname()[1], 65_536)
    blocker.close()
    with pytest.raises(OSError, match='of 192.0.2.77: .*this machine has no such address'):
        open_port('image_port', 0, 65_536, '192.0.2.77')
