"""A connection to a peer on the network, in a thread of its own, which begins again when it breaks."""

from __future__ import annotations

import asyncio
import random
import re
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import NamedTuple, Protocol

CONNECT_S, SEND_S = 10.0, 10.0  # longest time for a connection, and for a peer to take a message
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0  # between attempts; doubled until a connection lasts as long as that
MOST_WAITING = 256  # messages to be sent; the oldest are dropped
MOST_RECEIVED = 16  # messages received and not taken yet; no more are read
POLL_S = 0.05  # between looks at what waits: a quarter of the period of reports
LONGEST_PROBLEM = 200  # characters
JOIN_S = 3.0  # for which the node waits at its end


class Channel(Protocol):
    """An open connection. Its methods raise OSError where it has ended, and ValueError for what cannot be understood."""

    async def send(self, message: bytes) -> None:
        """Send a message."""

    async def receive(self) -> bytes:
        """The next message; never returns where there is none."""

    def close(self) -> None:
        """End it; may be called twice."""


class Received(NamedTuple):
    """What has happened since it was asked last.

    Parameters:
        session: number of the present connection; 0 while there is none.
        messages: that arrived on it.
    """

    session: int
    messages: list[bytes]


class Link:
    """Keeps a connection in a thread. Its methods return at once, and can be called from one other thread.

    Attributes:
        connections: how often it was connected.
        sent, dropped: numbers of messages.
        problem: why it is not connected, or was disconnected last; empty before.

    Parameters:
        connect: function that opens a connection. Whatever it raises is reported, and it is called again later.
    """

    def __init__(self, connect: Callable[[], Awaitable[Channel]]) -> None:
        self._connect = connect
        self.connections = self.sent = self.dropped = 0
        self.problem = ''
        self._session = 0
        self._outbox: deque[bytes] = deque(maxlen=MOST_WAITING)
        self._inbox: deque[bytes] = deque()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), name='link', daemon=True)
        self._thread.start()

    def take(self) -> Received:
        """What has arrived."""
        return Received(self._session, [self._inbox.popleft() for _ in range(len(self._inbox))])

    def put(self, messages: Sequence[bytes], session: int) -> None:
        """Send messages. What belongs to an earlier connection is dropped, and the oldest where too many wait.

        Parameters:
            messages: to be sent.
            session: number of the connection for which they are made.
        """
        for message in messages:
            is_late = session != self._session or not session
            self.dropped += is_late or len(self._outbox) == MOST_WAITING
            if not is_late:
                self._outbox.append(message)

    def values(self) -> dict[str, object]:
        """What diagnostics tell of it."""
        return {'connections': self.connections, 'sent': self.sent, 'dropped': self.dropped,
                'last error': self.problem or 'none'}

    def close(self) -> None:
        """Send what waits, within the time that a message may take, and end."""
        self._closing.set()
        self._thread.join(JOIN_S)

    async def _run(self) -> None:
        pause = FIRST_PAUSE_S
        while not self._closing.is_set():
            begun = time.monotonic()
            try:
                await self._hold(await asyncio.wait_for(self._connect(), CONNECT_S))
            except Exception as error:  # noqa: BLE001  a peer and its library may cause any; none may end the thread
                self.problem = _words(error)
            finally:
                self._session = 0
            if time.monotonic() - begun > LONGEST_PAUSE_S:
                pause = FIRST_PAUSE_S
            await self._wait(pause * random.uniform(0.8, 1.2))
            pause = min(2.0 * pause, LONGEST_PAUSE_S)

    async def _hold(self, channel: Channel) -> None:
        """Serve a connection to its end."""
        self.connections += 1
        self._outbox.clear()
        self._inbox.clear()
        self._session = self.connections
        work = [asyncio.create_task(self._send(channel)), asyncio.create_task(self._receive(channel))]
        try:
            done, _ = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in work:
                task.cancel()
            channel.close()
            await asyncio.gather(*work, return_exceptions=True)

    async def _send(self, channel: Channel) -> None:
        """Send what waits, until the link is closed and nothing waits any more."""
        while self._outbox or not self._closing.is_set():
            if not self._outbox:
                await asyncio.sleep(POLL_S)
                continue
            await asyncio.wait_for(channel.send(self._outbox.popleft()), SEND_S)
            self.sent += 1

    async def _receive(self, channel: Channel) -> None:
        while True:
            message = await channel.receive()
            while len(self._inbox) >= MOST_RECEIVED:
                await asyncio.sleep(POLL_S)
            self._inbox.append(message)

    async def _wait(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not self._closing.is_set():
            await asyncio.sleep(POLL_S)


class StreamChannel:
    """A stream of TCP or TLS.

    Parameters:
        reader, writer: of asyncio.
        next_message: function that reads the next message; it may raise asyncio.IncompleteReadError.
        frame: function from a message to its bytes on the stream.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter,
                 next_message: Callable[[asyncio.StreamReader], Awaitable[bytes]],
                 frame: Callable[[bytes], bytes] = bytes) -> None:
        self._reader, self._writer, self._next_message, self._frame = reader, writer, next_message, frame

    async def send(self, message: bytes) -> None:
        """Send a message, as soon as the peer takes it."""
        self._writer.write(self._frame(message))
        await self._writer.drain()

    async def receive(self) -> bytes:
        """The next message. Raises ConnectionError when the peer has ended the stream."""
        try:
            return await self._next_message(self._reader)
        except asyncio.IncompleteReadError as error:
            raise ConnectionResetError('the peer has ended the connection') from error

    def close(self) -> None:
        """End the stream, without waiting for the peer."""
        with suppress(Exception):
            self._writer.transport.abort() if self._writer.transport.get_write_buffer_size() else self._writer.close()


def _words(error: BaseException) -> str:
    return (str(error) or type(error).__name__)[:LONGEST_PROBLEM]


def parse_peer(text: str) -> tuple[str, int]:
    """Host and port of `host:port` or `[address]:port`. Raises ValueError for anything else."""
    match = re.fullmatch(r'\[?([^\s\[\]]+?)\]?:(\d{1,5})', text)
    if not match or not 0 < int(match[2]) < 65536:
        raise ValueError(f'peer is {text!r:.80}, expected host:port such as 192.168.1.5:5020')
    return match[1], int(match[2])
