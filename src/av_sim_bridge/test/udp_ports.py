"""UDP ports for a rig under test, which no other program of this machine has or gets."""

from __future__ import annotations

from ros_domains import asked_from, free_choice

from av_sim_bridge.wire.ports import Ports

# Ports from 32768 are Linux's ephemeral ports. Participants of DDS look for others at even ports of a domain's 250 (RTPS 2.3,
# 9.6.1.1): a rig whose ports are among these gets what they send.
_OFFSETS = [250 * step + more for step in range(-35, 7) if step != 0 for more in (0, 10, 20, 30, 40)]


def free_offset() -> int:
    """A `port_offset` at which all ports of a rig are free. Raises OSError when there is none."""
    shifted = {offset: Ports().shifted(offset) for offset in _OFFSETS}
    asked = {offset: {asked_from(port) for port in vars(ports).values()} - {None} for offset, ports in shifted.items()}
    return free_choice('offset', {offset: vars(ports).values() for offset, ports in shifted.items()}, asked)


def free_ports() -> Ports:
    """Ports of a rig that are free."""
    return Ports().shifted(free_offset())
