"""The air between source and microphone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from av_common.acoustics import speed_of_sound
from numpy.typing import NDArray

_NEAREST_M = 0.1


def inverse(distance: NDArray) -> NDArray:
    """Spherical spreading: 1 at 1 m, falling as 1/r."""
    return 1.0 / np.maximum(distance, _NEAREST_M)


@dataclass(frozen=True)
class Medium:
    """`attenuation` turns distances in m at emission into the gain relative to 1 m."""

    temperature_c: float = 20.0
    attenuation: Callable[[NDArray], NDArray] = inverse

    @property
    def speed_of_sound(self) -> float:
        """In m/s."""
        return speed_of_sound(self.temperature_c)
