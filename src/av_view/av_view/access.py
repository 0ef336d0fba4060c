"""Who may read and who may control: names of hosts, origins of pages, and a token."""

from __future__ import annotations

import hmac
import ipaddress
import os
import secrets
import socket
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from tempfile import mkstemp
from urllib.parse import urlsplit

from av_common.files import ros_home


class Access:
    """Rules for requests to a server of this machine.

    A page of another site reaches a server of this machine by a name that its owner points there (DNS rebinding), or directly.
    The first shows in the header Host, the second in Origin.

    Attributes:
        token: opens control; empty where nothing is to be controlled.

    Parameters:
        control: whether anything may be controlled.
        hosts: further names by which this machine is called.
        token: of the process before; empty for a new one.
    """

    def __init__(self, control: bool, hosts: Iterable[str] = (), token: str = '') -> None:
        self.token = (token or secrets.token_urlsafe(24)) if control else ''
        self._names = {'localhost', socket.gethostname().lower(), *(host.lower() for host in hosts if host)}

    def refusal(self, hosts: Iterable[str], origins: Iterable[str]) -> str:
        """Why a request is refused; empty where it is not.

        Parameters:
            hosts: values of its header Host, of which there must be one.
            origins: values of its header Origin, of which there may be one.
        """
        host, origin = list(hosts), list(origins)
        if len(host) != 1 or not self._is_known(host[0]):
            return f'Host is {", ".join(host)[:80]!r}, expected an address, localhost or a name of allowed_hosts'
        if len(origin) > 1 or not {*map(str.lower, origin)} <= {f'{how}://{host[0].lower()}' for how in ('http', 'https')}:
            return f'Origin is {", ".join(origin)[:80]!r}, expected the page of this server'
        return ''

    def may_control(self, token: object) -> bool:
        """Whether a token is the right one; compared in constant time."""
        return bool(self.token) and isinstance(token, str) and token.isascii() and hmac.compare_digest(token, self.token)

    def _is_known(self, host: str) -> bool:
        """An address cannot be pointed elsewhere, other names must be known."""
        with suppress(ValueError):
            name = urlsplit(f'http://{host}').hostname or ''
            return name in self._names or bool(ipaddress.ip_address(name))
        return False


class PrivateAddress:
    """The address with the token: in a file that its owner alone can read, and on the terminal, never in a log.

    Parameters:
        port: TCP port of the page, by which the file is named.
    """

    def __init__(self, port: int) -> None:
        self.file = ros_home() / f'page_{port}.address'

    def token(self) -> str:
        """The token of the process before, so that open pages stay valid when this one replaces it; empty for none."""
        with suppress(OSError, UnicodeError):
            return self.file.read_text().strip().rpartition('#')[2]
        return ''

    def remove(self) -> None:
        """Remove the file, whose token opens nothing any more."""
        self.file.unlink(missing_ok=True)

    def write(self, address: str) -> None:
        """Replace the file, and tell the terminal from which the rig was launched. Raises OSError."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = mkstemp(dir=self.file.parent)  # of mode 0600
        with os.fdopen(handle, 'w') as file:
            print(address, file=file)
        Path(name).replace(self.file)
        with suppress(OSError), Path('/dev/tty').open('w') as terminal:  # no part of what a launch writes to its logs
            print(f'the rig in your browser, with control: {address}', file=terminal)
