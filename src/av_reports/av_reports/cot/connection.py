"""Reports to TAK, and the way of their events: UDP to a group or a host, TCP, TLS. What comes back is dropped."""

from __future__ import annotations

import asyncio
import os
import socket
import ssl
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

from av_reports.cot.stage import CotStage
from av_reports.link import Channel, Link, StreamChannel
from av_reports.stage import Situation

SCHEMES = ('udp', 'tcp', 'tls')
PASSWORD = 'PYTAK_TLS_CLIENT_PASSWORD'  # variable of the environment, as other programs for TAK name it
LARGEST_DATAGRAM = 1400  # bytes, so that none is cut in pieces


def check_address(address: Any) -> None:
    """Raise ValueError where an address cannot be used.

    Parameters:
        address: the parameters `cot` of report_node: url (udp://239.2.3.1:6969, udp://host:port, tcp://host:port or
            tls://host:port), and of TLS the files client_cert, client_key and ca_file, in PEM.
    """
    parts = urlparse(address.url)
    try:
        usable = parts.scheme in SCHEMES and bool(parts.hostname) and bool(parts.port) and not parts.path
    except ValueError:  # the port is no number
        usable = False
    if not usable:
        raise ValueError(f'cot.url is {address.url!r:.80}, expected udp://239.2.3.1:6969, or udp, tcp or tls and a host:port')
    if parts.scheme == 'tls':
        for name in ('client_cert', 'client_key', 'ca_file'):
            file = getattr(address, name)
            if not Path(file).is_file():
                raise ValueError(f'cot.{name} is {file!r}, expected a file: tls needs a certificate, its key, and that of the '
                                 'authority which signed that of the server')


async def connect(address: Any, multicast_interface: str = '0.0.0.0') -> Channel:
    """Open the way. Raises OSError where the peer cannot be reached, or certificates cannot be used.

    Parameters:
        address: where to, see `check_address`.
        multicast_interface: address of the interface from which groups are sent to; 0.0.0.0 leaves it to the system.
    """
    parts = urlparse(address.url)
    if parts.scheme == 'udp':
        found = await asyncio.get_running_loop().getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_DGRAM)
        family, _, _, _, peer = found[0]
        own = socket.socket(family, socket.SOCK_DGRAM)
        if family == socket.AF_INET:
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(multicast_interface))
        return DatagramChannel(own, peer)
    context = None
    if parts.scheme == 'tls':
        context = ssl.create_default_context(cafile=address.ca_file)
        context.load_cert_chain(address.client_cert, address.client_key, os.environ.get(PASSWORD, ''))
    return StreamChannel(*await asyncio.open_connection(parts.hostname, parts.port, ssl=context), drop)


async def drop(reader: asyncio.StreamReader) -> bytes:
    """Read to the end of a stream, without a message. Raises asyncio.IncompleteReadError there."""
    while await reader.read(1 << 16):
        pass
    raise asyncio.IncompleteReadError(b'', None)


class DatagramChannel:
    """Events as datagrams, to groups no further than this network (a hop is what the system sets).

    Parameters:
        own: socket.
        peer: its address.
    """

    def __init__(self, own: socket.socket, peer: Any) -> None:
        self._own, self._peer = own, peer

    async def send(self, message: bytes) -> None:
        """Send an event. Raises ValueError for one that does not fit."""
        if len(message) > LARGEST_DATAGRAM:
            raise ValueError(f'an event of {len(message)} bytes, expected at most {LARGEST_DATAGRAM}')
        self._own.sendto(message, self._peer)

    async def receive(self) -> bytes:
        """Nothing ever comes."""
        return await asyncio.get_running_loop().create_future()

    def close(self) -> None:
        """Close the socket."""
        self._own.close()


class CotOutput:
    """Events of Cursor on Target.

    Parameters:
        uid, callsign: of the rig, see `CotStage`.
        address: where to, see `check_address`.
    """

    def __init__(self, uid: str, callsign: str, address: Any) -> None:
        self._address = address
        self._stage = CotStage(uid, callsign)
        self._link = Link(partial(connect, address))
        self._placeless = False

    def report(self, situation: Situation) -> None:
        """Send the events that are due."""
        self._placeless = situation.place is None
        session = self._link.take().session
        if session:
            self._link.put(self._stage.on_tracks(situation.tracks, situation.place, situation.now), session)

    def problem(self) -> str:
        """Why nothing is reported."""
        if not self._link.take().session:
            return f'{self._address.url} is not connected: {self._link.problem or "no answer yet"}'
        return 'the place of the rig is not known: it needs the topic fix, or surveyed.latitude' if self._placeless else ''

    def values(self) -> dict[str, object]:
        """Numbers of what was sent."""
        return {'peer': self._address.url, **self._link.values()}

    def close(self) -> None:
        """End the connection."""
        self._link.close()
