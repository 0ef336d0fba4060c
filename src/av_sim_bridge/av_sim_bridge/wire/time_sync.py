"""The simulator's clock in Unix time, sent to a multicast group as by RFlySim; the bridge needs none."""

import struct
from dataclasses import dataclass

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
