"""The way of events to TAK, by the optional package `pytak`: UDP to a group or a host, TCP, TLS. What comes back is dropped."""

from __future__ import annotations

import asyncio
import os
import warnings
from collections.abc import Sequence
from configparser import ConfigParser
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlparse

from av_reports.link import Channel, StreamChannel

SCHEMES = ('udp', 'tcp', 'tls')
PASSWORD = 'PYTAK_TLS_CLIENT_PASSWORD'  # variable of the environment, since parameters are no place for it
LARGEST_DATAGRAM = 1400  # bytes, so that none is cut in pieces


class CotAddress(NamedTuple):
    """Where events go.

    Parameters:
        url: udp://239.2.3.1:6969, udp://host:port, tcp://host:port or tls://host:port.
        multicast_interface: address of the interface from which groups are sent to; 0.0.0.0 leaves it to the system.
        client_cert, client_key, ca_file: files of TLS, in PEM.
    """

    url: str
    multicast_interface: str = '0.0.0.0'
    client_cert: str = ''
    client_key: str = ''
    ca_file: str = ''


def check_address(address: CotAddress) -> None:
    """Raise ValueError where an address cannot be used."""
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


async def connect(address: CotAddress) -> Channel:
    """Open the way. Raises ImportError without pytak, OSError where the peer cannot be reached, others of pytak.

    Parameters:
        address: where to.
    """
    pytak = load_pytak()
    reader, writer = await pytak.protocol_factory(_pytak_config(address))
    if isinstance(writer, asyncio.StreamWriter):
        return StreamChannel(reader, writer, bytes, lambda _: ())
    return DatagramChannel(writer)


def load_pytak() -> Any:
    """The module pytak. Raises ImportError that says what to install."""
    try:
        with warnings.catch_warnings():  # about packages of which nothing is used here
            warnings.simplefilter('ignore')
            import pytak
    except ImportError as error:
        raise ImportError(f'Cursor on Target needs the Python package pytak: pip install pytak ({error})') from error
    return pytak


class DatagramChannel:
    """Events as datagrams.

    Parameters:
        client: of pytak.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    async def send(self, message: bytes) -> None:
        """Send an event. Raises ValueError for one that does not fit."""
        if len(message) > LARGEST_DATAGRAM:
            raise ValueError(f'an event of {len(message)} bytes, expected at most {LARGEST_DATAGRAM}')
        await self._client.send(message)

    async def receive(self) -> Sequence[bytes]:
        """Nothing ever comes."""
        await asyncio.Event().wait()
        return ()

    def close(self) -> None:
        """Close the socket."""
        self._client.close()


def _pytak_config(address: CotAddress) -> Any:
    parts = urlparse(address.url)
    values = {
        'COT_URL': f'{parts.scheme}+wo://{parts.netloc}', 'PYTAK_MULTICAST_TTL': '1',
        'PYTAK_MULTICAST_LOCAL_ADDR': address.multicast_interface, 'PYTAK_TLS_CLIENT_CERT': address.client_cert,
        'PYTAK_TLS_CLIENT_KEY': address.client_key, 'PYTAK_TLS_CLIENT_CAFILE': address.ca_file,
        'PYTAK_TLS_CLIENT_CIPHERS': 'HIGH:!aNULL', PASSWORD: os.environ.get(PASSWORD, '')}
    config = ConfigParser(interpolation=None)
    config['cot'] = {name: value for name, value in values.items() if value}
    return config['cot']
