"""Threads that meet errors nobody thought of: they count them, report them, and go on."""

import socket
import threading
import time

import pytest

from av_sim_bridge.receiving.consumer import Consumer, Worker
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


def test_a_worker_goes_on_after_errors_and_reports_each_kind_once(reported):
    steps = []

    def step():
        steps.append(len(steps))
        if len(steps) < 4:
            raise OverflowError('too large')

    worker = Worker('worker', step)
    wait(lambda: len(steps) > 10)
    worker.stop()
    assert worker.failed == 3 and 'too large' in worker.last_error
    assert [str(error) for error in reported] == ['too large']


def test_a_consumer_goes_on_after_errors(reported):
    done = []
    consumer = Consumer('consumer', lambda item: done.append(1 / item))
    for item in (0, 1, 0, 2):
        wait(lambda: not consumer._items)
        consumer.put(item)
    consumer.stop()
    assert done == [1.0, 0.5] and consumer.failed == 2 and len(reported) == 1


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
    assert receiver.failed == 2 and len(reported) == 1
