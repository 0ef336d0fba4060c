"""The UDP sockets of the simulator: one from which it sends, and a port for commands to its rig."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator

from av_sim_bridge.receiving.allowed_senders import AllowedSenders, Refusals, SenderGate, ipv4
from av_sim_bridge.receiving.receiver import open_port

log = logging.getLogger('simulator')


class ControlPort:
    """Receives from the allowed senders only, which by default is the bridge; others are refused, counted and logged.

    Raises OSError if the port is not available, ValueError if other machines reach it and none may send to it.

    Parameters:
        port: UDP port.
        bind_address: address of this machine at which the port is opened, 0.0.0.0 for all.
        allowed: the senders that are obeyed.
    """

    MOST = 100              # datagrams taken in one call, so that a flood does not hold up the simulation
    BUFFER_BYTES = 65_536

    def __init__(self, port: int, bind_address: str, allowed: AllowedSenders) -> None:
        allowed.check_bind_address(bind_address)
        self.refusals = Refusals()
        self._allowed = allowed
        self._socket = open_port('control port', port, self.BUFFER_BYTES, bind_address)
        self._socket.setblocking(False)
        self._gate = SenderGate(self._socket, allowed, self.refusals)

    def receive(self) -> Iterator[bytes]:
        """The datagrams that have arrived, the oldest first."""
        self._gate.renew()
        for _ in range(self.MOST):
            try:
                datagram, sender = self._socket.recvfrom(65_535)
            except BlockingIOError:
                return
            if self._gate.admits(sender):
                yield datagram
            elif self.refusals.total in (1, 10, 100, 1000):
                log.warning('command from %s:%d refused, obeyed is %s; %d refused so far', *sender, self._allowed,
                            self.refusals.total)

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


def address_towards(host: str) -> str:
    """The address of this machine from which a host is reached. Raises OSError.

    Parameters:
        host: IPv4 address.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((host, 9))    # sends nothing
        return str(probe.getsockname()[0])


def sending_socket(address: str) -> socket.socket:
    """A UDP socket that sends from an address of this machine, multicast into the network of that address, too.

    Raises OSError where this machine has no such address.
    """
    packed = ipv4('bind_address', address).packed
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, packed)
    sender.bind((address, 0))
    return sender
