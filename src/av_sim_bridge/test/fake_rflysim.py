"""RFlySim's datagrams, packed here byte by byte from its documented layouts: nothing of the package under test is used."""

from __future__ import annotations

import struct


class FakeRflysim:
    """Hands datagrams for the ports of one rig to `deliver(port, datagram)`; numbers as RFlySim has them: NED, FRD, SI."""

    def __init__(self, ports, deliver):
        self._ports, self._send = ports, deliver

    def sound(self, samples):
        """Samples (n, channels) int16: interleaved, without any header."""
        self._send(self._ports.audio, samples.astype('<i2').tobytes())

    def image(self, data, time, frame_id=None):
        """An encoded image in pieces of 60,000 bytes; with a frame id behind the new header."""
        pieces = [data[start:start + 60_000] for start in range(0, len(data), 60_000)]
        for number, piece in enumerate(pieces):
            if frame_id is None:
                header = struct.pack('<4i1d', 1234567890, 24 + len(piece), number, len(pieces), time)
            else:
                header = struct.pack('<6i1d', 1234567893, 32 + len(piece), number, len(pieces), frame_id, 0, time)
            self._send(self._ports.image, header + piece)

    def oracle(self, *boxes):
        """Boxes (id, score, min x, min y, max x, max y) of the image sent last."""
        self._send(self._ports.image, struct.pack('<i', len(boxes)) + b''.join(struct.pack('<i5f', *box) for box in boxes))

    def truth(self, port, copter_id, time, position, velocity, euler, quaternion, rate):
        """SOut2Simulator, 168 bytes."""
        self._send(port, struct.pack('<4i24f7d', 123456789, copter_id, 3, 0, *velocity, *euler, *quaternion,
                                     *[9000.0] * 8, 0.0, 0.0, 0.0, *rate, time, *position, 0.0, 0.0, 0.0))

    def short_truth(self, port, copter_id, time, position, velocity, euler):
        """The layout of 112 bytes."""
        self._send(port, struct.pack('<6i14f4d', 1234567891, copter_id, 3, 0, 0, 0, *[9000.0] * 8, *velocity, *euler,
                                     *position, time))

    def imu(self, number, time, acceleration, rate):
        self._send(self._ports.imu, struct.pack('<2i1d6f', 1234567898, number, time, *acceleration, *rate))
