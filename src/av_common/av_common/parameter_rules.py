"""What every parameter of every node must fulfil, besides the bounds of its own description."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

LONGEST_TEXT, LONGEST_LIST = 4096, 1024  # characters of a text, elements of a list


class ParameterError(ValueError):
    """Parameters that cannot be used; the message names the parameter, its value and what is expected."""


class RenamedParameterError(ParameterError):
    """A parameter is given by a name that it no longer has; the message names the old and the new name."""

    def __init__(self, old: str, new: str) -> None:
        super().__init__(f'the parameter {old} is now named {new}')


class RemovedParameterError(ParameterError):
    """A parameter is given that there no longer is; the message names it and says what holds instead."""

    def __init__(self, name: str, instead: str) -> None:
        super().__init__(f'the parameter {name} is gone: {instead}')


def check_former(renamed: Mapping[str, str], removed: Mapping[str, str], is_given: Callable[[str], bool]) -> None:
    """Raise RenamedParameterError or RemovedParameterError for a parameter of an earlier version that is given.

    Parameters:
        renamed: former names, and present ones.
        removed: former names, and what holds instead.
        is_given: whether a parameter is given.
    """
    for name, new in renamed.items():
        if is_given(name):
            raise RenamedParameterError(name, new)
    for name, instead in removed.items():
        if is_given(name):
            raise RemovedParameterError(name, instead)


def check_value(name: str, value: Any) -> None:
    """Raise ParameterError for numbers that are not finite, and for texts and lists without measure.

    Parameters:
        name: the parameter.
        value: its value; of any type that parameters have.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise ParameterError(f'{name} is {value}, expected a finite number')
    if isinstance(value, str):
        if len(value) > LONGEST_TEXT:
            raise ParameterError(f'{name} has {len(value)} characters, expected at most {LONGEST_TEXT}')
    elif hasattr(value, '__len__'):
        if len(value) > LONGEST_LIST:
            raise ParameterError(f'{name} has {len(value)} elements, expected at most {LONGEST_LIST}')
        for element in value:
            check_value(name, element)


def check_together(check: Callable[[Any], None], settings: Any) -> None:
    """Raise ParameterError when `check` raises ValueError for `settings`.

    Parameters:
        check: `check_parameters` of a node.
        settings: the generated struct of its parameters.
    """
    try:
        check(settings)
    except ParameterError:
        raise
    except ValueError as error:
        raise ParameterError(str(error)) from error
