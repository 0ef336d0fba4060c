"""Commands to the simulated rig: yaw rate and gimbal angles. The layout is specific to this project."""

import struct
from dataclasses import dataclass

from av_sim_bridge.wire.error import WireError, check_magic, check_number, check_within, unpack

MAGIC = 1234567950  # own
VERSION = 1  # of the layout
_LAYOUT = struct.Struct('<5i3f')
_MOVE_BODY, _MOVE_GIMBAL = 1, 2
MOST_YAW_RATE, MOST_ANGLE = 100.0, 100.0    # rad/s, rad


@dataclass(frozen=True)
class RigControl:
    """One command, in the rig's frame (x forward, y left, z up).

    Parameters:
        sequence: number of the command, increasing by one.
        mode: mode of av_interfaces/PointingCommand.
        yaw_rate (rad/s): yaw rate, counter-clockwise; None does not move the body.
        pan, tilt (rad): angles counter-clockwise from x, and upwards; None does not move the gimbal.
    """

    sequence: int
    mode: int
    yaw_rate: float | None = None
    pan: float | None = None
    tilt: float | None = None


def encode_rig_control(command: RigControl) -> bytes:
    """The 32 bytes of one command. Raises WireError for one that no receiver would accept."""
    check_rig_control(command)
    flags = (_MOVE_BODY * (command.yaw_rate is not None)
             | _MOVE_GIMBAL * (command.pan is not None and command.tilt is not None))
    return _LAYOUT.pack(MAGIC, VERSION, command.sequence, command.mode, flags,
                        command.yaw_rate or 0.0, command.pan or 0.0, command.tilt or 0.0)


def decode_rig_control(datagram: bytes) -> RigControl:
    """Decode one command. Raises WireError."""
    magic, version, sequence, mode, flags, yaw_rate, pan, tilt = unpack(_LAYOUT, datagram, 'rig control')
    check_magic(magic, MAGIC, 'rig control')
    if version != VERSION:
        raise WireError(f'rig control: version {version}, {VERSION} expected')
    check_number(flags, 'rig control: flags', _MOVE_BODY | _MOVE_GIMBAL)
    check_rig_control(RigControl(sequence, mode, yaw_rate, pan, tilt))
    body, gimbal = flags & _MOVE_BODY, flags & _MOVE_GIMBAL
    return RigControl(sequence, mode, yaw_rate if body else None, pan if gimbal else None, tilt if gimbal else None)


def check_rig_control(command: RigControl) -> None:
    """Raise WireError for a command whose numbers are not within their limits."""
    check_number(command.sequence, 'rig control: sequence')
    check_number(command.mode, 'rig control: mode', 255)
    check_within(command.yaw_rate or 0.0, MOST_YAW_RATE, 'rig control: yaw rate')
    check_within([command.pan or 0.0, command.tilt or 0.0], MOST_ANGLE, 'rig control: angle')
