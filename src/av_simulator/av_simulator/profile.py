"""Time-dependent quantities of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.config_reader import LARGEST, LONGEST, ConfigError, number
from av_common.files import shown


@dataclass(frozen=True)
class Profile:
    """A quantity that is piecewise linear in time, and constant before the first and after the last point.

    Parameters:
        times (s): times of the points, strictly increasing.
        values: values at these times.
    """

    times: tuple[float, ...] = (0.0,)
    values: tuple[float, ...] = (0.0,)

    def __call__(self, time: ArrayLike) -> NDArray | float:
        """Value at a time (s), or values at times of any shape."""
        return np.interp(np.asarray(time, float), self.times, self.values)

    @classmethod
    def from_yaml(cls, content: object, key: str) -> Profile:
        """The profile of a number, or of a list of [time, value]. Raises ConfigError for decreasing times or values below 0.

        Parameters:
            content: content of the YAML node.
            key: path of the node, for the error message.
        """
        table = content if isinstance(content, list) else [[0.0, content]]
        if not 0 < len(table) <= LONGEST or not all(isinstance(row, list) and len(row) == 2 for row in table):
            raise ConfigError(f'{key}: {shown(content)}, expected a number or a list of 1 to {LONGEST} [time, value]')
        times = tuple(number(row[0], f'{key}[{index}][0]') for index, row in enumerate(table))
        name = f'{key}[{{}}][1]' if isinstance(content, list) else key
        values = tuple(number(row[1], name.format(index), bounds={'low': 0}) for index, row in enumerate(table))
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ConfigError(f'{key}: times are {shown(times)}, expected increasing times')
        return cls(times, values)

    @staticmethod
    def yaml_schema() -> dict:
        """JSON Schema of the content that `from_yaml` accepts."""
        value = {'type': 'number', 'minimum': 0, 'maximum': LARGEST}
        point = {'type': 'array', 'minItems': 2, 'maxItems': 2,
                 'prefixItems': [{'type': 'number', 'minimum': -LARGEST, 'maximum': LARGEST}, value]}
        return {'anyOf': [value, {'type': 'array', 'items': point, 'minItems': 1, 'maxItems': LONGEST}]}
