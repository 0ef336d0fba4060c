"""Speeds of the vehicle's motors, which hearing needs over its own rotors."""

from __future__ import annotations

import math
from typing import Any

RADIANS_PER_RPM = 2.0 * math.pi / 60.0
LARGEST = 1e4    # rad/s, more than any propeller's motor turns: such a number is none


def measured_speeds(message: Any) -> list[float]:
    """Speeds (rad/s) that the controllers of the motors report in an EscStatus, NaN for one that is not online."""
    count = min(message.esc_count, len(message.esc))
    return [_usable(RADIANS_PER_RPM * abs(message.esc[number].esc_rpm)) if message.esc_online_flags >> number & 1 else math.nan
            for number in range(count)]


def commanded_speeds(message: Any, full_speed: float) -> list[float]:
    """Speeds (rad/s) that an ActuatorMotors commands, up to the last motor that is commanded.

    A motor's speed is taken as proportional to its signal, which is the command where THR_MDL_FAC is 0, PX4's default.

    Parameters:
        message: the commands, 0 to 1, NaN for motors that stand still or do not exist
        full_speed (rad/s): at a command of 1
    """
    commands = [abs(float(command)) for command in message.control]
    last = max((number for number, command in enumerate(commands, 1) if math.isfinite(command)), default=0)
    return [_usable(full_speed * command) if command <= 1.0 else math.nan if command > 1.0 else 0.0
            for command in commands[:last]]


def _usable(speed: float) -> float:
    return speed if speed <= LARGEST else math.nan
