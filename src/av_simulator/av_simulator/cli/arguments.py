"""Types of command line arguments of a simulator."""

from __future__ import annotations

import math

from av_common.arguments import checked
from av_sim_bridge.wire.ports import Ports


def finite(text: str) -> float:
    """A finite number."""
    return checked(text, math.isfinite, 'a finite number')


def port_offset(text: str) -> int:
    """An integer with which every port stays between 1 and 65535."""
    ports = vars(Ports()).values()
    low, high = 1 - min(ports), 65_535 - max(ports)
    return int(checked(text, lambda value: value.is_integer() and low <= value <= high, f'an integer from {low} to {high}'))
