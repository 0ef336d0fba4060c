"""The connection to a fusion node over real sockets: what is sent, and peers that are silent, vanish, or send rubbish."""

from __future__ import annotations

import socket
import struct
import threading
import time
from contextlib import contextmanager, suppress
from functools import partial

import pytest

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
from link_peer import LONG_S, wait_for, without_pauses
from report_tracks import bearing
from sapient_peer import NODE, FusionNode, acknowledgement, task
from wire_decoder import dig, fields

from av_reports import link as link_module
from av_reports.link import Link, parse_peer
from av_reports.sapient.output import connect
from av_reports.sapient.stage import SapientStage
from av_reports.settings import SapientSettings

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    without_pauses(monkeypatch)


@contextmanager
def connected():
    """A fusion node, and the link of a node to it, in its first session."""
    fusion = FusionNode()
    link = Link(partial(connect, '127.0.0.1', fusion.port))
    try:
        fusion.meet()
        wait_for(lambda: link.take().session == 1)
        yield fusion, link
    finally:
        link.close()
        fusion.close()


def test_a_whole_session_is_read_by_an_independent_decoder():
    stage = SapientStage(SapientSettings(NODE))
    with connected() as (fusion, link):
        link.put(stage.on_connected(time.time()).messages, 1)
        assert dig(fusion.receive(), 4, 3) == b'audio-visual rig'
        fusion.send(acknowledgement())
        message, = receive(link)
        stage.on_message(message, None, time.time())
        link.put(stage.on_tracks([bearing(1), bearing(2)], time.time()).messages, 1)
        reports = [dig(fusion.receive(), 7) for _ in range(2)]
        assert len({dig(report, 2) for report in reports}) == 2
        assert all(dig(report, 5, 2) == pytest.approx(300.0) and 3 not in fields(dig(report, 5)) for report in reports)
        for piece in (lambda data: [data[:3], data[3:7], data[7:]])(struct.pack('<I', len(task())) + task()):
            fusion.peer.sendall(piece)
            time.sleep(0.02)
        message, = receive(link)
        link.put(stage.on_message(message, None, time.time()).messages, 1)
        assert dig(fusion.receive(), 9, 2) == 2, 'refused'
        wait_for(lambda: link.sent == 4)
        assert link.dropped == 0


def receive(link):
    messages = []

    def arrived():
        messages.extend(link.take().messages)
        return messages
    wait_for(arrived)
    return messages


@pytest.mark.parametrize('rubbish', [b'\xff\xff\xff\xff', b'\0\0\0\0', b'GET / HTTP/1.1\r\n\r\n',
                                     struct.pack('<I', (1 << 16) + 1), b'\x16\x03\x01\x02\x00'])
def test_after_rubbish_the_connection_is_made_anew(rubbish):
    with connected() as (fusion, link):
        fusion.peer.sendall(rubbish)
        fusion.meet()
        wait_for(lambda: link.take().session == 2)
        assert 'bytes, expected 1 to' in link.problem


def test_a_peer_that_disconnects_in_the_middle_of_a_message_is_connected_to_again():
    with connected() as (fusion, link):
        fusion.peer.sendall(struct.pack('<I', 100) + b'half')
        fusion.peer.close()
        fusion.meet()
        wait_for(lambda: link.take().session == 2)
        link.put([b'late'], 1)
        link.put([b'new'], 2)
        assert fusion.receive() == b'new' and link.dropped == 1


def test_a_reset_and_a_port_without_a_listener_are_survived():
    with connected() as (fusion, link):
        fusion.peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack('ii', 1, 0))
        fusion.listener.close()
        fusion.peer.close()
        wait_for(lambda: link.take().session == 0 and 'Connect call failed' in link.problem)
        link.put([b'nobody'], 0)
        assert link.dropped == 1
        fusion.listener = socket.create_server(('127.0.0.1', fusion.port))
        fusion.meet()
        wait_for(lambda: link.take().session == 2)


def test_a_peer_that_hangs_up_at_once_is_asked_more_and_more_rarely(monkeypatch):
    """Pauses of 0.05, 0.1, 0.2 and 0.4 s, each up to a fifth shorter: no peer of another protocol is asked each second."""
    class Gone:
        async def receive(self):
            raise ConnectionResetError

        def close(self):
            pass

    async def connect():
        return Gone()

    monkeypatch.setattr(link_module, 'LONGEST_PAUSE_S', LONG_S)
    begun, link = time.monotonic(), Link(connect)
    wait_for(lambda: link.connections == 5)
    assert time.monotonic() - begun > 0.8 * 0.75
    link.close()


def test_a_flood_is_read_no_faster_than_it_is_taken():
    with connected() as (fusion, link):
        fusion.peer.setblocking(False)
        flood, sent = struct.pack('<I', 1) + b'x', 0
        with suppress(BlockingIOError):
            while True:
                sent += fusion.peer.send(flood * 10_000)
        assert len(link._inbox) <= link_module.MOST_RECEIVED
        taken = 0
        while taken < 200:
            taken += len(link.take().messages)
            time.sleep(0.001)
        assert len(link._inbox) <= link_module.MOST_RECEIVED and sent < 100_000_000


def test_a_peer_that_takes_nothing_is_given_up_and_costs_bounded_memory(monkeypatch):
    monkeypatch.setattr(link_module, 'SEND_S', 0.5)
    with connected() as (_, link):
        message = b'x' * 100_000
        for _ in range(2 * link_module.MOST_WAITING):
            link.put([message], 1)
            assert len(link._outbox) <= link_module.MOST_WAITING
        wait_for(lambda: link.connections == 2)
        assert link.dropped > 0


def test_silence_is_waited_for_and_closing_says_goodbye():
    with connected() as (fusion, link):
        assert link.take() == (1, [])
        link.put([b'goodbye'], 1)
        link.close()
        assert fusion.receive() == b'goodbye' and fusion.peer.recv(1) == b''
    assert not any(thread.name == 'link' and thread.is_alive() for thread in threading.enumerate())


@pytest.mark.parametrize('text', ['', 'host', 'host:', ':5', 'host:0', 'host:70000', 'a b:5', 'host:5x', 'host:5:6 '])
def test_addresses_that_are_none_are_refused(text):
    with pytest.raises(ValueError, match='expected host:port'):
        parse_peer(text)


def test_addresses():
    assert parse_peer('localhost:5020') == ('localhost', 5020) and parse_peer('[::1]:5020') == ('::1', 5020)
