"""Attenuation of sound with distance: spherical spreading, the curves of game engines, or a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded

_NEAREST_M = 0.1
_CURVES = ('spherical', 'linear', 'logarithmic', 'inverse', 'table')


@dataclass(frozen=True)
class Attenuation:
    """Gain as a function of distance.

    `spherical` is 1/r with r in m. `linear`, `logarithmic` and `inverse` are Unreal Engine's curves: 1 up to `inner_m`, 0
    from `outer_m`, and in between 1 - s, -ln(s) / 2 or 0.02 / s, at most 1, where s rises linearly from 0 to 1. `table`
    interpolates linearly between points and is constant beyond them. Raises ValueError for an impossible curve.

    Parameters:
        curve: `spherical`, `linear`, `logarithmic`, `inverse` or `table`.
        inner_m (m): distance at which the three curves begin to fall.
        outer_m (m): distance at which the three curves reach 0.
        distances_m (m): distances of the table's points, increasing.
        gains: gains of the table's points.
    """

    curve: str = 'spherical'
    inner_m: float = 1.0
    outer_m: float = 200.0
    distances_m: Sequence[float] = ()
    gains: Sequence[float] = bounded((), low=0.0, high=1e3)

    def __post_init__(self) -> None:
        if self.curve not in _CURVES:
            raise ValueError(f'attenuation curve is {self.curve!r}, expected one of {_CURVES}')
        if not 0.0 <= self.inner_m < self.outer_m:
            raise ValueError(f'attenuation inner_m is {self.inner_m} and outer_m {self.outer_m}, '
                             'expected 0 <= inner_m < outer_m')
        pairs = len(self.distances_m)
        if self.curve == 'table' and (pairs < 2 or pairs != len(self.gains) or np.any(np.diff(self.distances_m) <= 0.0)):
            raise ValueError(f'attenuation distances_m are {list(self.distances_m)} and gains {list(self.gains)}, '
                             'expected two or more increasing distances and the same number of gains')

    def __call__(self, distance: NDArray) -> NDArray:
        """Gains at distances (m) of any shape."""
        if self.curve == 'spherical':
            return 1.0 / np.maximum(distance, _NEAREST_M)
        if self.curve == 'table':
            return np.interp(distance, self.distances_m, self.gains)
        share = np.clip((distance - self.inner_m) / (self.outer_m - self.inner_m), 0.0, 1.0)
        above = np.maximum(share, 1e-9)
        gain = {'linear': 1.0 - share, 'logarithmic': -0.5 * np.log(above), 'inverse': 0.02 / above}[self.curve]
        return np.where(share < 1.0, np.minimum(gain, 1.0), 0.0)
