"""The TCP connection of a node of SAPIENT to its fusion node."""

from __future__ import annotations

import asyncio
import socket
import struct

from av_reports.link import StreamChannel

LARGEST_RECEIVED = 1 << 16  # bytes; tasks and acknowledgements have some hundred
SILENT_MS = 20_000  # a peer that acknowledges nothing for this long is gone
LENGTH = struct.Struct('<I')
LARGEST_MESSAGE = 1 << 20  # bytes; the largest that the standard's own examples send has some 10 kB


class FramingError(ValueError):
    """A length that no message has: the stream cannot be read any further."""


def frame(message: bytes) -> bytes:
    """A message with its length in front. Raises FramingError for an empty or too large one."""
    _check(len(message), LARGEST_MESSAGE)
    return LENGTH.pack(len(message)) + message


class FrameReader:
    """Messages of a stream that arrives in pieces. It never holds more than one message of the largest size.

    Parameters:
        largest: size of the largest message that is accepted (bytes).
    """

    def __init__(self, largest: int = LARGEST_MESSAGE) -> None:
        self._largest = largest
        self._pending = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The messages that are complete with `data`.

        Raises FramingError for a length of 0 or above the largest, also when messages before it were complete.
        """
        self._pending += data
        messages, start = [], 0
        while len(self._pending) - start >= LENGTH.size:
            size, = LENGTH.unpack_from(self._pending, start)
            _check(size, self._largest)
            end = start + LENGTH.size + size
            if len(self._pending) < end:
                break
            messages.append(bytes(self._pending[start + LENGTH.size:end]))
            start = end
        del self._pending[:start]
        return messages


def _check(size: int, largest: int) -> None:
    if not 0 < size <= largest:
        raise FramingError(f'a message of {size} bytes, expected 1 to {largest}')


async def connect(host: str, port: int) -> StreamChannel:
    """Connect to a fusion node. Raises OSError where that fails.

    Parameters:
        host: name or address.
        port: of TCP.
    """
    reader, writer = await asyncio.open_connection(host, port)
    plain = writer.get_extra_info('socket')
    plain.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, SILENT_MS)
    return StreamChannel(reader, writer, frame, FrameReader(LARGEST_RECEIVED).feed)
