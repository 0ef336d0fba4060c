"""Types of command line arguments that refuse what cannot be, so that argparse names argument and value."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from av_sim_bridge.wire.ports import Ports


def positive(text: str) -> float:
    """A number above 0, inf among them."""
    return _number(text, lambda value: value > 0.0, 'a number above 0')


def not_negative(text: str) -> float:
    """A finite number from 0 on."""
    return _number(text, lambda value: 0.0 <= value < math.inf, 'a number from 0 on')


def seed(text: str) -> int:
    """A whole number from 0 on."""
    return int(_number(text, lambda value: value >= 0 and value.is_integer(), 'a whole number from 0 on'))


def port_offset(text: str) -> int:
    """A whole number that leaves every port between 1 and 65535."""
    ports = vars(Ports()).values()
    low, high = 1 - min(ports), 65_535 - max(ports)
    return int(_number(text, lambda value: value.is_integer() and low <= value <= high, f'a whole number, {low}..{high}'))


def renamed(new: str) -> Callable[[str], str]:
    """The type of an argument that has another name now."""
    def refuse(_text: str) -> str:
        raise argparse.ArgumentTypeError(f'is now named {new}')
    return refuse


def _number(text: str, fits: Callable[[float], bool], expected: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits(value):
        raise argparse.ArgumentTypeError(f'{text!r}, {expected} expected')
    return value
