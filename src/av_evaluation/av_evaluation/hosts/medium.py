"""Which frames of a network reach whom, and when: delay, loss and partitions."""

from __future__ import annotations

import random
import struct
from collections.abc import Collection, Sequence

MULTICAST = 0x01  # bit of the first byte of an address
ETHERNET, UDP = 14, 17  # length of the header (bytes), protocol in IPv4
_IPV4 = b'\x08\x00'


class Medium:
    """A switch between hosts whose cables delay and lose frames.

    Each receiver of a frame loses it independently. A frame to one host goes there alone as soon as that host has sent one.

    Parameters:
        hosts: their number.
        seed: of what is lost.
    """

    def __init__(self, hosts: int, seed: int = 0) -> None:
        self._hosts, self._delay, self._loss = hosts, 0.0, 0.0
        self._random = random.Random(seed)
        self._places: dict[bytes, int] = {}
        self._sides: Sequence[Collection[int]] = ()

    def impair(self, delay: float, loss: float) -> None:
        """Delay and lose frames from now on.

        Parameters:
            delay (s): of each frame.
            loss: probability that a frame is lost on its way to a receiver.
        """
        self._delay, self._loss = delay, loss

    def part(self, sides: Sequence[Collection[int]]) -> None:
        """Keep the frames of each side from the others; without sides all hear each other.

        Parameters:
            sides: indices of the hosts of each side.
        """
        self._sides = sides

    def deliveries(self, frame: bytes, sender: int, now: float) -> list[tuple[float, int]]:
        """Time (s) and receiver of each copy that arrives.

        Parameters:
            frame: of Ethernet.
            sender: index of the host.
            now (s): when it was sent.
        """
        self._places[frame[6:12]] = sender
        known = None if frame[0] & MULTICAST else self._places.get(frame[:6])
        receivers = [host for host in range(self._hosts) if host != sender] if known is None else [known]
        return [(now + self._delay, host) for host in receivers
                if self._connected(sender, host) and self._random.random() >= self._loss]

    def _connected(self, one: int, other: int) -> bool:
        return not self._sides or any(one in side and other in side for side in self._sides)


def without_checksum(frame: bytes) -> bytes:
    """The frame with the checksum of UDP over IPv4 set to 0, which says that there is none (RFC 768).

    Linux leaves the checksum of what it sends through a virtual cable to hardware that is not there.
    """
    if frame[12:14] != _IPV4 or len(frame) < ETHERNET + 20 or frame[ETHERNET + 9] != UDP:
        return frame
    fragment = struct.unpack_from('!H', frame, ETHERNET + 6)[0] & 0x1fff
    checksum = ETHERNET + 4 * (frame[ETHERNET] & 0x0f) + 6
    if fragment or len(frame) < checksum + 2:
        return frame
    return frame[:checksum] + b'\0\0' + frame[checksum + 2:]
