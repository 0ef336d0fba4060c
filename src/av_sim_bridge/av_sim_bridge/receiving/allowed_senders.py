"""Which senders of datagrams are accepted: addresses and networks, the counts of the others, and a defence against floods."""

from __future__ import annotations

import ctypes
import ipaddress
import socket
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

Sender = tuple[Any, ...]

LOOPBACK = ipaddress.IPv4Network('127.0.0.0/8')
_MOST_ENTRIES = 64  # of four or six instructions, far below the 4096 of a filter
_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27    # Linux
_SOURCE_ADDRESS = 0xFFF0_000C    # offset 12 in the IPv4 header (SKF_NET_OFF); offset 0 is the UDP header's source port
_LOAD, _LOAD_HALF, _AND, _JUMP_EQUAL, _RETURN = 0x20, 0x28, 0x54, 0x15, 0x06


class AllowedSenders:
    """A set of IPv4 addresses and networks, each with all ports or one.

    Parameters:
        entries: such as `192.168.1.20`, `192.168.1.0/24` or `192.168.1.20:30100`; empty texts are ignored.

    Raises ValueError that names an entry which is neither an address nor a network.
    """

    def __init__(self, entries: Sequence[str]) -> None:
        self.entries = tuple(filter(None, (entry.strip() for entry in entries)))
        if len(self.entries) > _MOST_ENTRIES:
            raise ValueError(f'allowed_senders has {len(self.entries)} entries, expected at most {_MOST_ENTRIES}')
        self._networks = [_network(entry) for entry in self.entries]
        self._rules = [(int(network.network_address), int(network.netmask), port) for network, port in self._networks]

    def __contains__(self, sender: Sender) -> bool:
        address = int.from_bytes(socket.inet_aton(sender[0]), 'big')
        return any(address & mask == network and port in (None, sender[1]) for network, mask, port in self._rules)

    def __str__(self) -> str:
        return ', '.join(self.entries) or 'nobody'

    @property
    def beyond_this_machine(self) -> bool:
        """Whether a sender on another machine is allowed."""
        return any(not network.subnet_of(LOOPBACK) for network, _ in self._networks)

    def check_bind_address(self, bind_address: str) -> None:
        """Raise ValueError where sockets at an address receive from nobody here, or from others than these senders.

        Parameters:
            bind_address: IPv4 address of this machine, 0.0.0.0 for all.
        """
        if ipv4('bind_address', bind_address).is_loopback == self.beyond_this_machine:
            raise ValueError(
                f'allowed_senders is {self}, but bind_address {bind_address} receives from this machine only, expected '
                "this machine's address in the network of those senders, or 0.0.0.0" if self.beyond_this_machine else
                f'bind_address is {bind_address}, which other machines reach, but allowed_senders is {self}, expected the '
                'address of the machine that sends, such as 192.168.1.20')

    def kernel_filter(self) -> bytes:
        """The same set as a program of the classic BSD packet filter, for SO_ATTACH_FILTER of a UDP socket."""
        program = []
        for network, mask, port in self._rules:
            both = [] if port is None else [(_LOAD_HALF, 0, 0, 0), (_JUMP_EQUAL, 0, 1, port)]
            program += [(_LOAD, 0, 0, _SOURCE_ADDRESS), (_AND, 0, 0, mask), (_JUMP_EQUAL, 0, len(both) + 1, network),
                        *both, (_RETURN, 0, 0, 0xFFFF_FFFF)]
        return b''.join(struct.pack('HBBI', *instruction) for instruction in [*program, (_RETURN, 0, 0, 0)])


class Refusals:
    """Counts of refused datagrams by address. The table holds the newest addresses only; may be used from any thread.

    Parameters:
        most: maximum number of addresses in the table.
        ports: whether each port of an address counts for itself.
    """

    def __init__(self, most: int = 8, ports: bool = False) -> None:
        self.total = 0
        self._most, self._ports = most, ports
        self._lock = threading.Lock()
        self._counts: OrderedDict[str, int] = OrderedDict()

    def add(self, sender: Sender) -> None:
        """Count one datagram."""
        with self._lock:
            self.total += 1
            name = f'{sender[0]}:{sender[1]}' if self._ports else sender[0]
            self._counts[name] = self._counts.get(name, 0) + 1
            self._counts.move_to_end(name)
            if len(self._counts) > self._most:
                self._counts.popitem(last=False)

    def counts(self) -> dict[str, int]:
        """Refused datagrams by address, the newest address first."""
        with self._lock:
            return dict(reversed(self._counts.items()))


class SenderGate:
    """Refuses and counts the datagrams of other senders at one socket.

    In a flood the kernel refuses them instead, without count, so that they take neither time nor the socket's buffer, for the
    rest of a period.

    Parameters:
        source: the socket that receives.
        allowed: senders to accept.
        refusals: counts, which several gates may share.
    """

    MOST = 100              # refused datagrams in a period that are counted; those that follow are left to the kernel
    PERIOD = 1.0            # s: a flood costs MOST datagrams in this time

    def __init__(self, source: socket.socket, allowed: AllowedSenders, refusals: Refusals) -> None:
        self._socket, self._allowed, self._refusals = source, allowed, refusals
        self._refused, self._until, self._filtered = 0, 0.0, False

    def admits(self, sender: Sender) -> bool:
        """Whether the datagram of a sender is accepted."""
        if sender in self._allowed:
            return True
        self._refusals.add(sender)
        self._refused += 1
        if self._refused == self.MOST:
            self._filter(True)
        return False

    def renew(self) -> None:
        """Count again after a period; called between datagrams."""
        if (now := time.monotonic()) < self._until:
            return
        self._until, self._refused = now + self.PERIOD, 0
        if self._filtered:
            self._filter(False)

    def _filter(self, on: bool) -> None:
        program = self._allowed.kernel_filter()
        code = ctypes.create_string_buffer(program, len(program))
        option = struct.pack('HP', len(program) // 8, ctypes.addressof(code))
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER if on else _SO_DETACH_FILTER, option)
        except OSError:    # not Linux: refused here one by one
            return
        self._filtered = on


def ipv4(parameter: str, text: str) -> ipaddress.IPv4Address:
    """An IPv4 address. Raises ValueError with the name of the parameter."""
    try:
        return ipaddress.IPv4Address(text)
    except ValueError as error:
        raise ValueError(f'{parameter} is {text!r}, expected an IPv4 address such as 127.0.0.1') from error


def resolve(parameter: str, host: str) -> str:
    """The IPv4 address of a host. Raises ValueError with the name of the parameter.

    Parameters:
        parameter: name of the parameter that gives the host.
        host: name or IPv4 address.
    """
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise ValueError(f'{parameter} is {host!r}, which is no IPv4 address and cannot be resolved: {error}') from error


def _network(entry: str) -> tuple[ipaddress.IPv4Network, int | None]:
    """Network and port of an entry, None for all ports. Raises ValueError."""
    network, colon, port = entry.partition(':')
    try:
        if colon and not (port.isdecimal() and 0 < int(port) < 65_536):
            raise ValueError(f'{port!r} is no port')
        return ipaddress.IPv4Network(network), int(port) if port else None
    except ValueError as error:
        raise ValueError(f'allowed_senders has {entry!r}, expected an IPv4 address or network, optionally with a port, such as '
                         f'192.168.1.20, 192.168.1.0/24 or 192.168.1.20:30100: {error}') from error
