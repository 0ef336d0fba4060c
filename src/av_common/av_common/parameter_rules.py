"""What every parameter of every node must fulfil, besides the bounds of its own description."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

LONGEST_TEXT, LONGEST_LIST = 4096, 1024  # characters of a text, elements of a list


class ParameterError(ValueError):
    """Parameters that cannot be used; the message names the parameter, its value and what is expected."""


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
