"""A thread that meets errors nobody thought of: it counts them, reports each kind once, and goes on."""

import socket
import threading
import time

import pytest

from av_sim_bridge.receiving.receiver import Receiver, open_port

PATIENCE = 60.0    # s


@pytest.fixture
def reported(monkeypatch):
    """Errors that were reported as unexpected."""
    errors = []
    monkeypatch.setattr(threading, 'excepthook', lambda arguments: errors.append(arguments.exc_value))
    return errors


def wait(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_receiver_goes_on_after_errors(reported):
    taken = []

    def handle(datagram, arrival, sender):
        taken.append(datagram)
        if datagram == b'bad':
            raise RuntimeError('unexpected')

    source = open_port('test', 0, 65536, '127.0.0.1')
    receiver = Receiver('test', source, handle)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for datagram in (b'bad', b'good', b'bad', b'good'):
            sender.sendto(datagram, ('127.0.0.1', receiver.port))
    wait(lambda: len(taken) == 4)
    wait(lambda: receiver.meter.count == 2)
    receiver.stop()
    assert receiver.failed == 2 and 'unexpected' in receiver.last_error
    assert [str(error) for error in reported] == ['unexpected']
