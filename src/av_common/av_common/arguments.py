"""Types of command line arguments. They refuse invalid values, so that argparse reports the argument and the value."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def positive(text: str) -> float:
    """A number above 0; inf is allowed."""
    return checked(text, lambda value: value > 0.0, 'a number above 0')


def not_negative(text: str) -> float:
    """A finite number, 0 or more."""
    return checked(text, lambda value: 0.0 <= value < math.inf, 'a number of 0 or more')


def whole(text: str) -> int:
    """An integer, 0 or more."""
    return int(checked(text, lambda value: value >= 0 and value.is_integer(), 'an integer of 0 or more'))


def number(text: str) -> int:
    """An integer above 0."""
    return int(checked(text, lambda value: value >= 1 and value.is_integer(), 'an integer above 0'))


def within(low: float, high: float, whole: bool = False) -> Callable[[str], float]:
    """A type of numbers with bounds.

    Parameters:
        low, high: smallest and largest number.
        whole: whether they are integers.
    """
    def parse(text: str) -> float:
        value = checked(text, lambda value: low <= value <= high and (not whole or value.is_integer()),
                        f'{"an integer" if whole else "a number"} of {low:g} to {high:g}')
        return int(value) if whole else value
    return parse


def checked(text: str, fits: Callable[[float], bool], expected: str) -> float:
    """The number that a text gives. Raises ArgumentTypeError where it does not fit.

    Parameters:
        text: as typed.
        fits: whether a number is accepted; NaN stands for what is none.
        expected: what fits, in words.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits(value):
        raise argparse.ArgumentTypeError(f'{text!r}, expected {expected}')
    return value
