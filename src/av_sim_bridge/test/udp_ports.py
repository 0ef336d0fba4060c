"""UDP ports for a rig under test, which no other program has or gets."""

from __future__ import annotations

import random
import socket

from av_sim_bridge.wire.ports import Ports

# DDS uses the first ports of every 250 from 7400 (RTPS 2.3, 9.6.1.1), and ports from 32768 are Linux's ephemeral ports.
# The rig's ports avoid both, also with offsets of multiples of 250 and a few more.
_OFFSETS = [250 * step + more for step in range(-35, 7) if step != 0 for more in (0, 10, 20, 30, 40)]


def free_offset() -> int:
    """A `port_offset` at which all ports of a rig are free. Raises OSError when there is none."""
    for offset in random.SystemRandom().sample(_OFFSETS, len(_OFFSETS)):
        ports = Ports().shifted(offset)
        if all(map(_is_free, [*vars(ports).values(), ports.depth])):
            return offset
    raise OSError(f'no free ports for a rig at any offset of {min(_OFFSETS)}..{max(_OFFSETS)}')


def free_ports() -> Ports:
    """Ports of a rig that are free."""
    return Ports().shifted(free_offset())


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
    return True
