"""The only commands to the autopilot that this package can make: they move a gimbal and nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass

GIMBAL_PITCH_YAW = 1000    # MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW
GIMBAL_CONFIGURE = 1001    # MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
ALLOWED = frozenset({GIMBAL_PITCH_YAW, GIMBAL_CONFIGURE})
RELEASE = -3.0             # as system and component of 1001: give up control


@dataclass(frozen=True)
class Command:
    """A `VehicleCommand`: its number and param1 to param7. Raises ValueError for any number that is not ALLOWED."""

    command: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.command not in ALLOWED:
            raise ValueError(f'command is {self.command}, allowed are {sorted(ALLOWED)}')
        if len(self.params) != 7:
            raise ValueError(f'params has {len(self.params)} values, expected 7')


def configure(system: float, component: float, gimbal_id: int) -> Command:
    """Claim the gimbal manager's primary control, or with RELEASE twice give it up; secondary control is left alone."""
    return Command(GIMBAL_CONFIGURE, (system, component, -1.0, -1.0, 0.0, 0.0, float(gimbal_id)))


def pitch_yaw(pitch_deg: float, yaw_deg: float, flags: int, gimbal_id: int) -> Command:
    """Point the gimbal: pitch up and yaw to the right in degrees; rates are left to the gimbal."""
    return Command(GIMBAL_PITCH_YAW, (pitch_deg, yaw_deg, math.nan, math.nan, float(flags), 0.0, float(gimbal_id)))
