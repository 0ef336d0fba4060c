"""Each stream has one sender, address and port, at a time: what another one sends is refused by name, until a silence."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('av_interfaces.msg', reason='needs the built workspace')

from av_common.rig import GimbalMount, load_rig
from av_sim_bridge.receiving.receiver import Receiver, open_port
from av_sim_bridge.stage import BridgeStage
from av_sim_bridge.vehicle import VehicleState, to_truth
from av_sim_bridge.wire import ForeignSenderError, WireError
from av_sim_bridge.wire.audio import AudioFormat, AudioHeader, encode_audio
from av_sim_bridge.wire.gimbal import GimbalSample, encode_gimbal
from av_sim_bridge.wire.image import EncodedImage, encode_image
from av_sim_bridge.wire.imu import ImuSample, encode_imu
from av_sim_bridge.wire.oracle import OracleBox, encode_oracle
from av_sim_bridge.wire.time_sync import TimeSync, encode_time_sync
from av_sim_bridge.wire.truth import encode_truth

RIG = Path(__file__).resolve().parents[3] / 'config' / 'rig.yaml'
EPOCH, RATE, PERIOD = 1_700_000_000.0, 48_000, 0.02
FIRST, OTHER_PORT, OTHER_HOST = ('127.0.0.1', 50_000), ('127.0.0.1', 50_001), ('192.168.1.9', 50_000)
HAND_OVER_S = 1.0
LEVEL, FALSE = 0.25, 0.75  # what the first and the other sender say, in whatever a stream carries
STREAMS = ('audio', 'bare audio', 'image', 'oracle', 'depth', 'rig truth', 'target truth', 'imu', 'gimbal', 'time sync')


def picture(value, depth):
    """A PNG whose pixels say 100 times a value."""
    return cv2.imencode('.png', np.full((2, 2), 100 * value, depth))[1].tobytes()


class Bench:
    """A stage, and what it made of the datagrams of one stream: the values that reached a topic."""

    def __init__(self, stream: str) -> None:
        rig = dataclasses.replace(load_rig(RIG), gimbal=GimbalMount())
        self.stage = BridgeStage(rig, AudioFormat(), oracle_detections=True)
        self.stream, self.obeyed = stream, []

    def take(self, sender: tuple[str, int], number: int, value: float) -> None:
        """A datagram of the stream by a sender whose clock is right, at the time number * PERIOD. Raises WireError."""
        t, stage, kind = number * PERIOD, self.stage, self.stream
        arrival, found = EPOCH + t + 0.001, []
        if kind in ('audio', 'bare audio'):
            frames = round(RATE * PERIOD)
            header = AudioHeader(number, frames, t - PERIOD) if kind == 'audio' else None
            datagram = encode_audio(AudioFormat(), np.full((frames, 2), value), header)
            found = [float(np.round(frame.samples[-1], 2)) for _, frame in stage.on_audio(datagram, arrival, sender)]
        elif kind == 'time sync':
            stage.on_time_sync(encode_time_sync(TimeSync(1, 0, round(1e3 * (EPOCH + value)), number)), arrival, sender)
            found = [round(arrival - EPOCH - stage.counts()['time sync offset (s)'], 2)]
        elif kind == 'oracle':
            if sender == FIRST:
                stage.on_image(encode_image(EncodedImage(t, picture(value, np.uint8)))[0], arrival, sender)
            (_, report), = stage.on_image(encode_oracle([OracleBox(2, value, 0.0, 0.0, 9.0, 9.0)]), arrival, sender)
            found = [round(report.detections[0].results[0].hypothesis.score, 2)]
        elif kind in ('image', 'depth'):
            take, depth = (stage.on_image, np.uint8) if kind == 'image' else (stage.on_depth, np.uint16)
            (_, message), *_ = take(encode_image(EncodedImage(t, picture(value, depth)))[0], arrival, sender)
            found = [message.data[0] / 100]
        elif kind == 'imu':
            (_, message), = stage.on_imu(encode_imu(ImuSample(number, t, np.full(3, value), np.zeros(3))), arrival, sender)
            found = [round(message.linear_acceleration.x, 2)]
        elif kind == 'gimbal':
            outputs = stage.on_gimbal(encode_gimbal(GimbalSample(number, t, np.array([1.0, 0, 0, 0]), value)), arrival, sender)
            found = [round(message.variance, 2) for _, message in outputs]
        else:
            state = to_truth(VehicleState(t, np.full(3, value)), 1 if kind == 'rig truth' else 2)
            outputs = stage.on_truth(encode_truth(state), arrival, sender)
            found = [round(message.pose.pose.position.x, 2) for _, message in outputs]
        self.obeyed += found


@pytest.mark.parametrize('other', [OTHER_PORT, OTHER_HOST])
@pytest.mark.parametrize('stream', STREAMS)
def test_another_sender_moves_nothing_and_is_named(stream, other):
    """Whatever it sends, as often, with the right clock: 2 s, then it is on its own, and has the stream 1 s later."""
    bench, refused = Bench(stream), 0
    for number in range(100, 300):
        bench.take(FIRST, number, LEVEL)
        if number >= 200:
            with pytest.raises(ForeignSenderError, match=rf'{other[0]}:{other[1]}.*{FIRST[0]}:{FIRST[1]}'):
                bench.take(other, number, FALSE)
    assert set(bench.obeyed) == {LEVEL} and len(bench.obeyed) > 150
    bench.obeyed.clear()
    for number in range(300, 300 + round(HAND_OVER_S / PERIOD) - 2):
        with pytest.raises(ForeignSenderError):
            bench.take(other, number, FALSE)
        refused += 1
    assert not bench.obeyed and refused > 40
    if stream == 'oracle':
        return  # boxes belong to images: who sends none has none
    for number in range(352, 452):
        bench.take(other, number, FALSE)
        with pytest.raises(ForeignSenderError):
            bench.take(FIRST, number, LEVEL)
    assert LEVEL not in bench.obeyed and len(bench.obeyed) > 60


@pytest.mark.parametrize('first, then', [('bare audio', 'audio'), ('audio', 'bare audio')])
def test_a_header_is_no_licence_to_take_the_sound_over(first, then):
    bench = Bench(first)
    for number in range(100, 200):
        bench.stream = first
        bench.take(FIRST, number, LEVEL)
        bench.stream = then
        with pytest.raises(ForeignSenderError):
            bench.take(OTHER_PORT, number, FALSE)
    assert set(bench.obeyed) == {LEVEL}


def after_a_step_back(stream, monkeypatch, before, after):
    """What is obeyed of a simulator that starts again while the machine's clock is set back by an hour.

    Parameters:
        stream: see `Bench`.
        before, after: numbers of the datagrams of the first and the second simulator.
    """
    bench = Bench(stream)
    for number in before:
        bench.take(FIRST, number, LEVEL)
    bench.obeyed.clear()
    monkeypatch.setitem(globals(), 'EPOCH', EPOCH - 3600.0)
    for number in after:
        with contextlib.suppress(WireError):
            bench.take(OTHER_PORT, number, FALSE)
    return bench.obeyed


@pytest.mark.parametrize('stream', ['bare audio', 'time sync'])
def test_a_stream_is_handed_over_after_a_step_back_of_the_clock(stream, monkeypatch):
    obeyed = after_a_step_back(stream, monkeypatch, range(100, 150), range(200, 300))
    assert LEVEL not in obeyed and len(obeyed) > 40


@pytest.mark.parametrize('stream', ['rig truth', 'target truth', 'imu', 'gimbal'])
def test_states_of_a_restarted_simulator_are_new_after_a_step_back_of_the_clock(stream, monkeypatch):
    """Though their stamps begin anew and their dates are those of an hour ago."""
    obeyed = after_a_step_back(stream, monkeypatch, range(400, 500), range(10, 210))
    assert LEVEL not in obeyed and len(obeyed) > 80


def test_the_receiver_counts_and_names_them_apart_from_malformed_ones():
    def handle(datagram, _, sender):
        if datagram == b'other':
            raise ForeignSenderError('some', sender, FIRST)
        if datagram != b'genuine':
            raise WireError('malformed')

    source = open_port('some_port', 0, 1 << 16)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(('127.0.0.1', 0))
        receiver, end = Receiver('some', source, handle), time.monotonic() + 20.0
        for datagram in (b'other', b'x', b'other', b'genuine'):
            sender.sendto(datagram, ('127.0.0.1', receiver.port))
        while receiver.meter.count < 1 and time.monotonic() < end:
            time.sleep(0.005)
        assert (receiver.foreign.total, receiver.failed, receiver.meter.count) == (2, 1, 1)
        assert list(receiver.foreign.counts()) == ['{}:{}'.format(*sender.getsockname())]
        receiver.stop()
