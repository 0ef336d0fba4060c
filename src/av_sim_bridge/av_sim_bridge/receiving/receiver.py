"""Threads that take datagrams from UDP ports and hand them on with the time of their arrival."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import threading
import time
from collections.abc import Callable

from av_common.rate_meter import RateMeter
from av_sim_bridge.wire import WireError

Handler = Callable[[bytes, float, tuple], None]

_TIMEVAL = struct.Struct('qq')
_SO_TIMESTAMPNS = 35      # Linux: the kernel stamps arrivals, so that a busy interpreter does not
_SO_RCVBUFFORCE = 33      # Linux: beyond net.core.rmem_max, for root
_LARGEST = 65_535


def open_port(parameter: str, port: int, buffer_bytes: int, address: str = '',
              multicast_group: str | None = None) -> socket.socket:
    """A UDP socket that receives on a port. Raises OSError naming the parameter when the port cannot be had."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if multicast_group is not None:    # several rigs may listen to one clock
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        receiver.bind((address, port))
        if multicast_group is not None:
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP,
                                socket.inet_aton(multicast_group) + socket.inet_aton('0.0.0.0'))
    except OSError as error:
        receiver.close()
        hint = ', another program listens there' if error.errno == errno.EADDRINUSE else ''
        raise OSError(f'{parameter}: cannot receive on UDP port {port}: {error.strerror}{hint}') from error
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    for option, value in ((_SO_RCVBUFFORCE, buffer_bytes), (_SO_TIMESTAMPNS, 1)):
        with contextlib.suppress(OSError):    # not root, or not Linux: the buffer and clock at hand have to do
            receiver.setsockopt(socket.SOL_SOCKET, option, value)
    receiver.settimeout(0.2)
    return receiver


class Receiver:
    """One port, one thread. Malformed datagrams are counted, and the newest complaint is kept.

    Parameters:
        name: of the stream.
        source: a bound UDP socket, which this object closes.
        handle: called with datagram, arrival (s of the system's clock) and the sender's address; may raise WireError.
    """

    def __init__(self, name: str, source: socket.socket, handle: Handler):
        self.name = name
        self.meter = RateMeter()
        self.malformed = 0
        self.complaint = ''
        self._socket, self._handle = source, handle
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=f'receive {name}', daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port it receives on."""
        return self._socket.getsockname()[1]

    def stop(self) -> None:
        """End the thread and give the port back."""
        self._stopping = True
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while not self._stopping:
            try:
                datagram, ancillary, _, sender = self._socket.recvmsg(_LARGEST, socket.CMSG_SPACE(_TIMEVAL.size))
            except TimeoutError:
                continue
            try:
                self._handle(datagram, _arrival(ancillary), sender)
            except WireError as error:
                self.malformed += 1
                self.complaint = str(error)
            else:
                self.meter.tick()


def _arrival(ancillary: list) -> float:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _TIMEVAL.size:
            seconds, nanoseconds = _TIMEVAL.unpack_from(data)
            return seconds + 1e-9 * nanoseconds
    return time.time()
