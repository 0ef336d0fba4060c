"""The simulator's clock in Unix time, sent to a multicast group."""

import struct
from dataclasses import dataclass

from av_sim_bridge.wire.error import LATEST_S, WireError, check_magic, check_number, unpack

MAGIC = 123456789  # RFlySim's
_LAYOUT = struct.Struct('<2i3q')


@dataclass(frozen=True)
class TimeSync:
    """Relation between the sender's clock and Unix time.

    Parameters:
        copter_id: number of the vehicle in the simulator.
        start_ms (ms): Unix time at which the sender's clock was zero.
        now_ms (ms): Unix time of sending.
        heartbeat: number of the datagram, increasing by one.
    """

    copter_id: int
    start_ms: int
    now_ms: int
    heartbeat: int


def encode_time_sync(sync: TimeSync) -> bytes:
    """The 32 bytes of one heartbeat."""
    return _LAYOUT.pack(MAGIC, sync.copter_id, sync.start_ms, sync.now_ms, sync.heartbeat)


def decode_time_sync(datagram: bytes) -> TimeSync:
    """Decode one heartbeat. Raises WireError."""
    magic, copter_id, start_ms, now_ms, heartbeat = unpack(_LAYOUT, datagram, 'time sync')
    check_magic(magic, MAGIC, 'time sync')
    check_number(heartbeat, 'time sync: heartbeat', 2**53)
    check_number(now_ms, 'time sync: now', int(1e3 * LATEST_S))
    if not 0 <= start_ms <= now_ms:
        raise WireError(f'time sync: now is {now_ms} ms, before the start at {start_ms} ms')
    return TimeSync(copter_id, start_ms, now_ms, heartbeat)
