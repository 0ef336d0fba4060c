"""UDP ports for a rig under test, which no other program of this machine has or gets."""

from __future__ import annotations

from ros_domains import asked_from, free_choice

from av_sim_bridge.wire.ports import Ports

# Ports from 32768 are Linux's ephemeral ports. Participants of DDS look for others at even ports of a domain's 250 (RTPS 2.3,
# 9.6.1.1): a rig whose ports are among these gets what they send.
_OFFSETS = [250 * step + more for step in range(-35, 7) if step != 0 for more in (0, 10, 20, 30, 40)]


def free_offset(targets: int = 1) -> int:
    """A `port_offset` at which all ports of a rig are free. Raises OSError when there is none.

    Parameters:
        targets: number of targets; ports of many reach those of participants of DDS.
    """
    rigs = {offset: Ports().shifted(offset) for offset in _OFFSETS}
    further = {offset: range(rig.target_truth + 2, rig.target_truth + 2 * targets, 2) for offset, rig in rigs.items()}
    ports = {offset: [*vars(rig).values(), *further[offset]] for offset, rig in rigs.items()}
    asked = {offset: {asked_from(port) for port in (*vars(rig).values(), *(port - 1 for port in further[offset]))} - {None}
             for offset, rig in rigs.items()}
    return free_choice('offset', ports, asked)


def free_ports() -> Ports:
    """Ports of a rig that are free."""
    return Ports().shifted(free_offset())
