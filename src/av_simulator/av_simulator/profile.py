"""Time-dependent quantities of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.config_reader import ConfigError


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
        table = [[0.0, content]] if _is_number(content) else content
        if not (isinstance(table, list) and table
                and all(isinstance(row, list) and len(row) == 2 and all(map(_is_number, row)) for row in table)):
            raise ConfigError(f'{key}: {content!r}, expected a number or a list of [time, value]')
        times, values = zip(*table, strict=True)
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ConfigError(f'{key}: times are {list(times)}, expected increasing times')
        if min(values) < 0:
            raise ConfigError(f'{key}: {min(values)}, expected 0 or more')
        return cls(tuple(map(float, times)), tuple(map(float, values)))

    @staticmethod
    def yaml_schema() -> dict:
        """JSON Schema of the content that `from_yaml` accepts."""
        point = {'type': 'array', 'prefixItems': [{'type': 'number'}, {'type': 'number', 'minimum': 0}],
                 'minItems': 2, 'maxItems': 2}
        return {'anyOf': [{'type': 'number', 'minimum': 0}, {'type': 'array', 'items': point, 'minItems': 1}]}


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))
