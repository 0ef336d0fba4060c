"""Types of command line arguments. They refuse invalid values, so that argparse reports the argument and the value."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from av_sim_bridge.wire.ports import Ports


def positive(text: str) -> float:
    """A number above 0; inf is allowed."""
    return _number(text, lambda value: value > 0.0, 'a number above 0')


def not_negative(text: str) -> float:
    """A finite number, 0 or more."""
    return _number(text, lambda value: 0.0 <= value < math.inf, 'a number of 0 or more')


def seed(text: str) -> int:
    """An integer, 0 or more."""
    return int(_number(text, lambda value: value >= 0 and value.is_integer(), 'an integer of 0 or more'))


def port_offset(text: str) -> int:
    """An integer with which every port stays between 1 and 65535."""
    ports = vars(Ports()).values()
    low, high = 1 - min(ports), 65_535 - max(ports)
    return int(_number(text, lambda value: value.is_integer() and low <= value <= high, f'an integer from {low} to {high}'))


def _number(text: str, fits: Callable[[float], bool], expected: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits(value):
        raise argparse.ArgumentTypeError(f'{text!r}, expected {expected}')
    return value
