"""The only MAVLink commands that this package can create: configuration and pointing of a gimbal."""

from __future__ import annotations

import math
from dataclasses import dataclass

GIMBAL_PITCH_YAW = 1000    # MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW
GIMBAL_CONFIGURE = 1001    # MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
ALLOWED = frozenset({GIMBAL_PITCH_YAW, GIMBAL_CONFIGURE})
COMPONENT = 191            # of this rig: MAV_COMP_ID_ONBOARD_COMPUTER of MAVLink
ALL_GIMBALS = 0.0          # in place of the number of a gimbal
ROLL_AND_PITCH_LOCK = 4.0 + 8.0    # of MAVLink's GIMBAL_MANAGER_FLAGS
RELEASE = -3.0             # as system and component of 1001: give up control


@dataclass(frozen=True)
class Command:
    """A `VehicleCommand`. Raises ValueError for a number that is not ALLOWED.

    Parameters:
        command: number of the MAVLink command
        params (7 values, units as MAVLink's): param1 to param7
    """

    command: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.command not in ALLOWED:
            raise ValueError(f'command is {self.command}, allowed are {sorted(ALLOWED)}')


def configure(system: float, component: float) -> Command:
    """Claim or release the primary control of the gimbal manager; the secondary control stays as it is.

    Parameters:
        system: MAVLink id of the system in control, RELEASE to give control up
        component: MAVLink id of the component in control, RELEASE to give control up
    """
    return Command(GIMBAL_CONFIGURE, (system, component, -1.0, -1.0, 0.0, 0.0, ALL_GIMBALS))


def pitch_yaw(pan: float, tilt: float, locked: bool) -> Command:
    """Point the gimbal, by MAVLink's pitch (deg, up) and yaw (deg, to the right); the gimbal chooses the rates.

    Parameters:
        pan (rad): angle to the left
        tilt (rad): angle upwards
        locked: whether roll and pitch are those from the horizon; yaw is relative to the vehicle
    """
    flags = ROLL_AND_PITCH_LOCK if locked else 0.0
    return Command(GIMBAL_PITCH_YAW, (math.degrees(tilt), -math.degrees(pan), math.nan, math.nan, flags, 0.0, ALL_GIMBALS))
