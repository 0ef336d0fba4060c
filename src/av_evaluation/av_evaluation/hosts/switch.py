"""A switch in user space: carries frames between network interfaces through a `Medium` (Linux)."""

from __future__ import annotations

import heapq
import selectors
import socket
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

from av_evaluation.hosts.medium import Medium, without_checksum

EVERY_PROTOCOL, OUTGOING, LARGEST = 3, 4, 65535    # ETH_P_ALL, PACKET_OUTGOING, bytes of a frame


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
