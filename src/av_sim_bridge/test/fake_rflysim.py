"""RFlySim's datagrams, packed here byte by byte from its documented layouts: nothing of the package under test is used."""

from __future__ import annotations

import struct


def image_datagrams(data, time, frame_id=None):
    """An encoded image in pieces of 60,000 bytes; with a frame id behind the new header."""
    pieces = [data[start:start + 60_000] for start in range(0, len(data), 60_000)]
    return [(struct.pack('<4i1d', 1234567890, 24 + len(piece), number, len(pieces), time) if frame_id is None else
             struct.pack('<6i1d', 1234567893, 32 + len(piece), number, len(pieces), frame_id, 0, time)) + piece
            for number, piece in enumerate(pieces)]


def short_truth_datagram(copter_id, time, position, velocity, euler, rpm=(9000.0,) * 8, gps=(0, 0, 0)):
    """The layout of 112 bytes; GPS in 1e-7 deg and mm."""
    return struct.pack('<6i14f4d', 1234567891, copter_id, 3, *gps, *rpm, *velocity, *euler, *position, time)


class FakeRflysim:
    """Hands datagrams for the ports of one rig to `deliver(port, datagram)`; numbers as RFlySim has them: NED, FRD, SI."""

    def __init__(self, ports, deliver):
        self._ports, self._send = ports, deliver

    def sound(self, samples):
        """Samples (n, channels) int16: interleaved, without any header."""
        self._send(self._ports.audio, samples.astype('<i2').tobytes())

    def image(self, data, time, frame_id=None):
        """An encoded image; see `image_datagrams`."""
        for datagram in image_datagrams(data, time, frame_id):
            self._send(self._ports.image, datagram)

    def oracle(self, *boxes):
        """Boxes (id, score, min x, min y, max x, max y) of the image sent last."""
        self._send(self._ports.image, struct.pack('<i', len(boxes)) + b''.join(struct.pack('<i5f', *box) for box in boxes))

    def truth(self, port, copter_id, time, position, velocity, euler, quaternion, rate):
        """SOut2Simulator, 168 bytes."""
        self._send(port, struct.pack('<4i24f7d', 123456789, copter_id, 3, 0, *velocity, *euler, *quaternion,
                                     *[9000.0] * 8, 0.0, 0.0, 0.0, *rate, time, *position, 0.0, 0.0, 0.0))

    def short_truth(self, port, *state):
        """See `short_truth_datagram`."""
        self._send(port, short_truth_datagram(*state))

    def imu(self, number, time, acceleration, rate):
        self._send(self._ports.imu, struct.pack('<2i1d6f', 1234567898, number, time, *acceleration, *rate))
