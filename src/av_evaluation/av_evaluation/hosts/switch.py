"""A switch in user space: carries frames between network interfaces through a `Medium` (Linux)."""

from __future__ import annotations

import heapq
import random
import selectors
import socket
import struct
import threading
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

EVERY_PROTOCOL, OUTGOING, LARGEST = 3, 4, 65535    # ETH_P_ALL, PACKET_OUTGOING, bytes of a frame


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


class Switch:
    """Carries the frames between interfaces in a thread, as a kernel without netem does not delay and lose them.

    Attributes:
        medium: what delays, loses and parts; may be parted meanwhile.

    Parameters:
        links: names of the interfaces, in the order of the medium's hosts.
        medium: see `Medium`.

    Raises OSError where raw sockets are not permitted.
    """

    def __init__(self, links: Sequence[str], medium: Medium) -> None:
        self.medium = medium
        self._sockets = []
        try:
            for link in links:
                self._sockets.append(socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(EVERY_PROTOCOL)))
                self._sockets[-1].bind((link, EVERY_PROTOCOL))
                self._sockets[-1].setblocking(False)
        except OSError:
            self._close_sockets()
            raise
        self._waiting: list[tuple[float, int, int, bytes]] = []
        self._numbers = count()
        self._closing = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, close the sockets."""
        self._closing = True
        self._thread.join(5.0)
        self._close_sockets()

    def _close_sockets(self) -> None:
        for one in self._sockets:
            one.close()

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            for index, one in enumerate(self._sockets):
                selector.register(one, selectors.EVENT_READ, index)
            while not self._closing:
                wait = self._waiting[0][0] - time.monotonic() if self._waiting else 0.1
                for key, _ in selector.select(min(max(wait, 0.0), 0.1)):
                    self._take(key.data)
                self._send_due()

    def _take(self, index: int) -> None:
        with suppress(BlockingIOError):
            while True:
                frame, address = self._sockets[index].recvfrom(LARGEST)
                if address[2] != OUTGOING:
                    frame = without_checksum(frame)
                    for due, host in self.medium.deliveries(frame, index, time.monotonic()):
                        heapq.heappush(self._waiting, (due, next(self._numbers), host, frame))

    def _send_due(self) -> None:
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, host, frame = heapq.heappop(self._waiting)
            with suppress(BlockingIOError):    # a full buffer loses it
                self._sockets[host].send(frame)


def sent_bytes(link: str) -> int:
    """Bytes that the host at the other end of a cable has sent, with the headers of Ethernet, by the kernel's counter."""
    for line in Path('/proc/net/dev').read_text().splitlines():
        name, _, numbers = line.partition(':')
        if name.strip() == link:
            return int(numbers.split()[0])
    raise ValueError(f'no interface {link}')
