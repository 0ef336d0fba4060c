"""Threads that receive datagrams from UDP ports and pass them on with their time of arrival."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

from av_common.rate_meter import RateMeter
from av_sim_bridge.receiving.allowed_senders import Refusals, Sender, SenderGate
from av_sim_bridge.wire import ForeignSenderError, UndatedError

Handler = Callable[[bytes, float, Sender], Any]

_TIMEVAL = struct.Struct('qq')
_SO_TIMESTAMPNS = 35      # Linux: arrival times from the kernel, independent of the load of the interpreter
_SO_RCVBUFFORCE = 33      # Linux: buffers beyond net.core.rmem_max, for root only
_IP_MULTICAST_ALL = 49    # Linux: 0 leaves out what other sockets of this machine have joined
_LARGEST = 65_535  # bytes of an IP packet


def open_port(name: str, port: int, buffer_bytes: int, address: str = '127.0.0.1',
              multicast_group: str | None = None) -> socket.socket:
    """A UDP socket that is bound to a port. Raises OSError with the stream's name if the port is not available.

    Parameters:
        name: name of the stream, for the error message.
        port: UDP port.
        buffer_bytes (bytes): size of the receive buffer that is requested from the operating system.
        address: local address to bind to, 0.0.0.0 for all.
        multicast_group: IPv4 address of a multicast group, of which alone the socket receives, through the network of
            `address`; None for unicast.
    """
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if multicast_group is not None:    # several rigs may receive the same clock
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        receiver.bind((multicast_group or address, port))
        if multicast_group is not None:
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP,
                                socket.inet_aton(multicast_group) + socket.inet_aton(address))
            receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
    except OSError as error:
        receiver.close()
        hint = {errno.EADDRINUSE: ', another program uses the port: end it, or choose another port_offset',
                errno.EADDRNOTAVAIL: ', this machine has no such address'}.get(error.errno or 0, '')
        raise OSError(f'{name}: cannot receive on UDP port {port} of {address}: {error.strerror}{hint}') from error
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    for option, value in ((_SO_RCVBUFFORCE, buffer_bytes), (_SO_TIMESTAMPNS, 1)):
        with contextlib.suppress(OSError):    # not root, or not Linux: keep the default buffer and clock
            receiver.setsockopt(socket.SOL_SOCKET, option, value)
    receiver.settimeout(0.2)
    return receiver


class Receiver:
    """Receives from one port on a thread, which outlives its errors. It closes the socket.

    Attributes:
        failed: number of datagrams that could not be used. Each new error but a ValueError, which is an invalid datagram, is
            reported as if it had ended the thread.
        foreign: counts of datagrams of others than the stream's sender.
        last_error: the newest error's message.
        meter: rate of the datagrams that were used.

    Parameters:
        name: name of the stream.
        source: bound UDP socket.
        handle: function of datagram, arrival (s, the system's clock) and the sender's address, for which `stop` waits; may
            raise WireError.
        gate: refuses datagrams of other senders before anything else is done with them; None accepts everybody.
    """

    def __init__(self, name: str, source: socket.socket, handle: Handler, gate: SenderGate | None = None) -> None:
        self.failed, self.last_error = 0, ''
        self.meter, self.foreign = RateMeter(), Refusals(3, ports=True)
        self._socket, self._handle, self._gate = source, handle, gate
        self._ending = False
        self._thread = threading.Thread(target=self._run, name=f'receive {name}', daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """UDP port of the socket."""
        return self._socket.getsockname()[1]

    def send(self, datagram: bytes, address: tuple[str, int]) -> None:
        """Send a datagram from this port. Raises OSError."""
        self._socket.sendto(datagram, address)

    def end(self) -> None:
        """Let the thread end after the present datagram, without waiting for it."""
        self._ending = True

    def stop(self) -> None:
        """End the thread, and close the socket."""
        self.end()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while not self._ending:
            try:
                self._receive()
            except ValueError as error:
                self.failed += 1
                self.last_error = str(error)
            except Exception as error:  # noqa: BLE001 (whatever a datagram causes: the next one is processed)
                self.failed += 1
                if repr(error) != self.last_error:
                    self.last_error = repr(error)
                    _report(error)

    def _receive(self) -> None:
        if self._gate is not None:
            self._gate.renew()
        try:
            datagram, ancillary, _, sender = self._socket.recvmsg(_LARGEST, socket.CMSG_SPACE(_TIMEVAL.size))
        except TimeoutError:
            return
        if self._gate is not None and not self._gate.admits(sender):
            return
        try:
            self._handle(datagram, _arrival(ancillary), sender)
            self.meter.tick()
        except ForeignSenderError as error:
            self.last_error = str(error)
            self.foreign.add(sender)
        except UndatedError as error:    # counted by the stream's clock
            self.last_error = str(error)


def _report(error: Exception) -> None:
    """Report an unexpected error as if it had ended the thread: by its traceback, and as a warning in tests."""
    threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, threading.current_thread())))


def _arrival(ancillary: list) -> float:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _TIMEVAL.size:
            seconds, nanoseconds = _TIMEVAL.unpack_from(data)
            return seconds + 1e-9 * nanoseconds
    return time.time()
