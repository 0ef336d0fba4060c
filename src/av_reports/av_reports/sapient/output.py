"""Reports to a fusion node of SAPIENT by its TCP connection, and its tasks."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable
from functools import partial

from av_reports.contacts import Command
from av_reports.link import Link, StreamChannel
from av_reports.sapient.stage import SapientStage
from av_reports.sapient.tasks import Reaction
from av_reports.settings import SapientSettings
from av_reports.stage import Situation

Perform = Callable[[Command, Callable[[str], None]], None]
LARGEST_RECEIVED = 1 << 16  # bytes; tasks and acknowledgements have some hundred
SILENT_MS = 20_000  # a peer that acknowledges nothing for this long is gone
LENGTH = struct.Struct('<I')


def frame(message: bytes) -> bytes:
    """A message with its length in front."""
    return LENGTH.pack(len(message)) + message


async def next_message(reader: asyncio.StreamReader) -> bytes:
    """The next message of a stream. Raises ValueError for a length that none has, asyncio.IncompleteReadError at the end."""
    size, = LENGTH.unpack(await reader.readexactly(LENGTH.size))
    if not 0 < size <= LARGEST_RECEIVED:
        raise ValueError(f'a message of {size} bytes, expected 1 to {LARGEST_RECEIVED}')
    return await reader.readexactly(size)


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
    return StreamChannel(reader, writer, next_message, frame)


class SapientOutput:
    """Reports to a fusion node of SAPIENT, and lets it give tasks.

    Parameters:
        settings: what the node is.
        peer: host and port of the fusion node.
        perform: function that has the rig do a command, and calls its second argument with the reason why it cannot, or with
            an empty one when it has begun.
    """

    def __init__(self, settings: SapientSettings, peer: tuple[str, int], perform: Perform) -> None:
        self._peer, self._perform = peer, perform
        self._stage = SapientStage(settings)
        self._link = Link(partial(connect, *peer))
        self._session = 0
        self._now = 0.0

    def report(self, situation: Situation) -> None:
        """Answer what has arrived, and report."""
        self._now = now = situation.now
        received = self._link.take()
        if received.session != self._session:
            if self._session:
                self._react(self._stage.on_disconnected())
            self._session = received.session
            if self._session:
                self._react(self._stage.on_connected(now))
        if not self._session:
            return
        for message in received.messages:
            self._react(self._stage.on_message(message, situation.place, now))
        self._react(self._stage.on_tracks(situation.tracks, now))
        self._react(self._stage.on_time(situation.place, situation.problems, situation.silent, now))

    def problem(self) -> str:
        """Why nothing is reported."""
        peer = f'the fusion node {self._peer[0]}:{self._peer[1]}'
        if not self._session:
            return f'{peer} is not connected: {self._link.problem or "no answer yet"}'
        if self._stage.session.refusal:
            return f'{peer} refuses the registration: {self._stage.session.refusal}'
        complaint = self._stage.complaint(self._now)
        if complaint:
            return f'{peer} {complaint}'
        return '' if self._stage.session.accepted else f'{peer} has not acknowledged the registration'

    def values(self) -> dict[str, object]:
        """Numbers of what was sent and received."""
        desk = self._stage.desk
        return {'peer': f'{self._peer[0]}:{self._peer[1]}', 'registered': self._stage.session.accepted, **self._stage.counts,
                'task': desk.active.task_id if desk.active else 'none', 'tasks accepted': desk.accepted,
                'tasks refused': desk.refused, **self._link.values()}

    def close(self) -> None:
        """Say goodbye, and end the task."""
        if self._session:
            self._react(self._stage.farewell(self._now))
            self._react(self._stage.on_disconnected())
        self._link.close()

    def _react(self, reaction: Reaction) -> None:
        self._link.put(reaction.messages, self._session)
        if reaction.command is not None:
            command = reaction.command
            self._perform(command, lambda reason: self._react(self._stage.on_done(command, reason, self._now)))
