"""Which modes the pilot has handed over to this rig, and who else steers the vehicle."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

OFFBOARD = 14                      # vehicle_status nav_state
EXTERNAL_MODES = range(23, 31)     # nav_state of external modes 1 to 8
SERVED = frozenset({OFFBOARD, *EXTERNAL_MODES})
# Inputs of PX4 that only one may send: those in dds_topics.yaml of PX4 1.14 to 1.18, with the versions of their messages.
_STEERS = re.compile(r'(offboard_control_mode|actuator_motors|actuator_servos|\w+_setpoint)(_v\d+)?')


@dataclass(frozen=True)
class VehicleStatus:
    """What a vehicle_status says.

    Parameters:
        nav_state: mode
        armed: whether the motors are armed
        failsafe: whether a failsafe of PX4 is active
        system_id: MAVLink id of the vehicle
        intended: mode that the pilot has selected, which a failsafe overrides; None where it is the present one
        activated (us): time of PX4 at which the mode began; it tells a mode that was left and entered again
    """

    nav_state: int
    armed: bool
    failsafe: bool
    system_id: int = 1
    intended: int | None = None
    activated: int = 0

    def overrides(self, mode: int) -> bool:
        """Whether PX4 overrides this mode in a failsafe, which would end in Hold if the mode was unregistered."""
        return self.armed and self.intended == mode != self.nav_state


class Handover:
    """Knows which modes the pilot has selected since this rig began to serve them, and since the last failsafe.

    A failsafe that began with a lost heartbeat, or with a silent external mode, ends as soon as either comes again, and PX4 is
    back in the mode that was selected before (flown in 1.17 and 1.18). So this rig must not return by itself: a mode counts
    as handed over only after the pilot was seen to have selected another one, without a failsafe, and then this one. A mode
    that PX4 overrides is in a failsafe, whatever the flag says. OFFBOARD that another program has steered, too, is no longer
    this rig's: its heartbeat would hide the end of that program.
    """

    def __init__(self) -> None:
        self._free: set[int] = set()    # modes that count as handed over once they are selected
        self._status: VehicleStatus | None = None
        self._failed = False

    def update(self, status: VehicleStatus, offered: bool, shared: bool = False) -> None:
        """Note a status.

        Parameters:
            status: of the vehicle
            offered: whether the heartbeat is being sent, without which the pilot selected OFFBOARD for somebody else
            shared: whether another program steers
        """
        before, self._status = self._status, status
        mode, intended = status.nav_state, status.nav_state if status.intended is None else status.intended
        if status.failsafe or (intended != mode and intended in SERVED):
            self._free.clear()
            self._failed = True
            return
        self._free |= SERVED - {mode, intended}
        entered = before is None or before.nav_state != mode
        unseen = not entered and before is not None and before.activated != status.activated
        if unseen or (mode == OFFBOARD and (shared or (entered and not offered))):
            self._free.discard(mode)
        self._failed = self._failed and mode not in self._free

    def refusal(self, mode: int) -> str:
        """Why `mode` is not handed over by being selected; empty if it is."""
        if mode in self._free:
            return ''
        return (f'{"a failsafe" if self._failed else "selected without this rig"}: select another mode first, then '
                f'{"OFFBOARD" if mode == OFFBOARD else "this one"} again')


def steers(name: str) -> bool:
    """Whether PX4 is steered by an input of this name, with or without the version of its message."""
    return _STEERS.fullmatch(name) is not None


def others_that_steer(own_name: str, own: Mapping[str, int], publishers: Mapping[str, Sequence[str]]) -> str:
    """Who else publishes what steers the vehicle, with the topic; empty if nobody does.

    Parameters:
        own_name: full name of this node
        own: number of this node's publishers of each topic
        publishers: full names of the nodes of all publishers, by topic
    """
    found = []
    for topic, names in sorted(publishers.items()):
        others = [name for name in names if name != own_name]
        if len(names) - len(others) > own.get(topic, 0):
            others.append(f'another {own_name}')
        found += [f'{_shown(name)} publishes {topic}' for name in sorted(set(others))]
    return ', '.join(found)


def _shown(name: str) -> str:
    return 'a program outside ROS' if '_NODE_NAME_UNKNOWN_' in name or '_CREATED_BY_BARE_DDS_APP_' in name else name

