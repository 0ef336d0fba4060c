"""The other end of a link, for tests on real sockets."""

from __future__ import annotations

import time

from av_reports import link

LONG_S = 60.0


def wait_for(condition):
    deadline = time.monotonic() + LONG_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert condition()


def without_pauses(monkeypatch):
    """Have links connect again at once."""
    monkeypatch.setattr(link, 'FIRST_PAUSE_S', 0.05)
    monkeypatch.setattr(link, 'LONGEST_PAUSE_S', 0.05)


def exactly(peer, size):
    """So many bytes from a socket."""
    data = b''
    while len(data) < size:
        piece = peer.recv(size - len(data))
        assert piece, 'the link has ended the connection'
        data += piece
    return data
