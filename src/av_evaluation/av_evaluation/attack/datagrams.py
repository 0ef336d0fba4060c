"""The process that sends hostile datagrams to every UDP port of the bridge and the simulator."""

from __future__ import annotations

import math
import socket
import struct
import time
import zlib
from collections import Counter
from dataclasses import replace
from random import Random

import numpy as np

from av_evaluation.attack.hostile import HostileValues
from av_evaluation.attack.worker import paced
from av_sim_bridge.wire.audio import AudioFormat, AudioHeader, encode_audio
from av_sim_bridge.wire.gimbal import GimbalSample, encode_gimbal
from av_sim_bridge.wire.image import EncodedImage, encode_image
from av_sim_bridge.wire.imu import ImuSample, encode_imu
from av_sim_bridge.wire.oracle import OracleBox, encode_oracle
from av_sim_bridge.wire.ports import TIME_SYNC_GROUP, Ports
from av_sim_bridge.wire.rig_control import RigControl, encode_rig_control
from av_sim_bridge.wire.time_sync import TimeSync, encode_time_sync
from av_sim_bridge.wire.truth import VehicleTruth, encode_truth

RANDOM_SIZES = (0, 1, 3, 7, 24, 32, 40, 112, 168, 1000, 6400, 65_000)
TIMES = (0.0, 1.0, 60.0, 1e4, 1.7e9, 1e300, -1.0, float('nan'), float('inf'))
BOMB_SIDE = 12_000      # px of an image that is small as a datagram and large in memory
BOMB_EVERY = 500        # datagrams of the image port
SOCKETS = 4
HOST = '127.0.0.1'


class Datagrams:
    """Sends datagrams from several sockets."""

    def __init__(self) -> None:
        self._sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(SOCKETS)]
        for one in self._sockets:
            one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        self._bomb = encode_image(EncodedImage(5.0, _bomb(BOMB_SIDE)))

    def attack(self, seconds: float, rate: float, seed: int, offset: int, kinds: tuple[str, ...]) -> dict[str, int]:
        """Send datagrams; returns their number by port.

        Parameters:
            seconds: duration.
            rate (Hz): of the datagrams to each port.
            seed: of the random values.
            offset: of all ports.
            kinds: in turns `structured` (the right layout with hostile values), `random` bytes, `clocks` that jump and drift.
        """
        values, sent = HostileValues(Random(seed)), Counter[str]()
        ports = vars(Ports().shifted(offset)) | {'depth': Ports().shifted(offset).depth}
        names, begun = sorted(ports), time.monotonic()
        for number in paced(seconds, rate * len(names)):
            name, kind = names[number % len(names)], kinds[number // len(names) % len(kinds)]
            elapsed = time.monotonic() - begun
            for datagram in self._datagrams(kind, name, number // len(names), elapsed, values):
                sent[name] += self._send(datagram, (HOST, ports[name]), values.random)
            if name == 'time_sync':
                sent[name] += self._send(datagram, (TIME_SYNC_GROUP, ports[name]), values.random)
        return dict(sent)

    def _datagrams(self, kind: str, name: str, number: int, elapsed: float, values: HostileValues) -> list[bytes]:
        random = values.random
        if kind == 'random':
            return [random.randbytes(random.choice(RANDOM_SIZES))]
        if kind == 'clocks' and name == 'control':
            return []    # of which each would be obeyed
        if kind == 'structured' and name in ('image', 'depth') and number % BOMB_EVERY == 0:
            return self._bomb
        moments = {'clocks': (0.4 * number, 1e300, elapsed + random.choice((-10.0, -0.4, 0.4, 10.0, 1e4)), 1.001 * elapsed),
                   'structured': (*TIMES, elapsed)}
        valid = genuine(name, number, random.choice(moments[kind]), values)
        return [values.mutilate(valid) if kind == 'structured' and random.random() < 0.8 else valid]

    def _send(self, datagram: bytes, address: tuple[str, int], random: Random) -> int:
        try:
            random.choice(self._sockets).sendto(datagram, address)
        except OSError:
            return 0    # refused by an earlier one's receiver, or too long
        return 1


def genuine(name: str, number: int, moment: float, values: HostileValues) -> bytes:
    """A datagram as a simulator sends it, with values that lead astray.

    Parameters:
        name: of the stream, as in `Ports`.
        number: of the datagram.
        moment (s): its time.
        values: source of the draws.
    """
    random = values.random
    if name == 'audio':
        layout, samples = AudioFormat(), np.zeros((random.choice((1, 160, 1600)), 2))
        return encode_audio(layout, samples, AudioHeader(number, len(samples), moment) if random.random() < 0.8 else None)
    if name == 'image' and random.random() < 0.7:
        x = random.uniform(0.0, 600.0)
        return encode_oracle([OracleBox(2, random.random(), x, 200.0, x + 40.0, 240.0)] * random.choice((0, 1, 1, 5)))
    if name in ('image', 'depth'):
        return encode_image(EncodedImage(moment, random.randbytes(2000)))[0]
    if name == 'imu':
        return encode_imu(ImuSample(number, moment, np.array([0.0, 0.0, -9.8]), np.array([0.0, 0.0, random.uniform(-1, 1)])))
    if name == 'gimbal':
        turned = random.uniform(-3.0, 3.0)
        return encode_gimbal(GimbalSample(number, moment, np.array([math.cos(turned), 0.0, 0.0, math.sin(turned)]), 1e-6))
    if name == 'time_sync':
        start = random.choice((0, 10**12, 2**62, int(1e3 * time.time())))
        return encode_time_sync(TimeSync(1, start, start + 1000 * number, number))
    if name == 'control' and random.random() < 0.7:
        return encode_rig_control(RigControl(number, 1, random.choice((0.7, -0.7, 99.0)), 0.0, 0.0))
    truth = VehicleTruth(1 if name != 'target_truth' else 2, 3, moment, np.array([random.uniform(-20, 20), 0.0, -2.0]),
                         np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(8))
    if random.random() < 0.1:
        truth = replace(truth, position_ned=np.array([1e300, 0.0, 0.0]))
    return encode_truth(truth, short=random.random() < 0.3)


def _bomb(side: int) -> bytes:
    """A black PNG image of `side` x `side` px: some 140 kB for 144 MB."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))
    packer, row = zlib.compressobj(9), bytes(side + 1)
    rows = b''.join(packer.compress(row) for _ in range(side)) + packer.flush()
    header = struct.pack('>2I5B', side, side, 8, 0, 0, 0, 0)
    return b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', header) + chunk(b'IDAT', rows) + chunk(b'IEND', b'')
