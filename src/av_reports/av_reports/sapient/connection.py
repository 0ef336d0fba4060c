"""The TCP connection of a node of SAPIENT to its fusion node."""

from __future__ import annotations

import asyncio
import socket

from av_reports.link import StreamChannel
from av_reports.sapient.framing import FrameReader, frame

LARGEST_RECEIVED = 1 << 16  # bytes; tasks and acknowledgements have some hundred
SILENT_MS = 20_000  # a peer that acknowledges nothing for this long is gone


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
