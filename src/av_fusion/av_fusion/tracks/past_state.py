"""The direction of a component at the capture time of a measurement."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.vectors import Vector, combined, dot, offset

ROW_ACROSS, ROW_UP = (1.0, 0.0), (0.0, 1.0)


class PastState(NamedTuple):
    """A Gaussian of the direction in the plane that touches the sphere at its mean.

    Parameters:
        direction, left, above: mean, and axes of the plane; unit vectors in the world.
        gain (5, 2): covariance of the component's present state with the direction along both axes.
        hh, hv, vv (rad^2): covariance of the direction.
        lag (s), moved (m): time since then, and displacement of the rig, in the world.
    """

    direction: Vector
    left: Vector
    above: Vector
    gain: NDArray[np.float64]
    hh: float
    hv: float
    vv: float
    lag: float
    moved: Vector

    def shifted(self, across: float, up: float) -> PastState:
        """The state with direction and axes moved by `across` and `up` (rad) along a great circle."""
        direction, left, above = self.direction, self.left, self.above
        length = math.hypot(across, up)
        if length < 1e-9:
            return self
        h, v, cosine, sine = across / length, up / length, math.cos(length), math.sin(length)
        along = combined(h, left, v, above)
        change = combined(cosine - 1.0, along, -sine, direction)
        return self._replace(direction=combined(cosine, direction, sine, along), left=combined(1.0, left, h, change),
                             above=combined(1.0, above, v, change))

    def variance(self, row: tuple[float, float]) -> float:
        """Variance (rad^2) of the direction along a row of derivatives."""
        h, v = row
        return h * h * self.hh + 2.0 * h * v * self.hv + v * v * self.vv

    def offset(self, target: Vector) -> tuple[float, float]:
        """Where a direction is in the plane, along both axes (rad)."""
        return offset(self.direction, self.left, self.above, target)

    def beside(self, axis: Vector) -> tuple[float, tuple[float, float]]:
        """Signed distance (rad) from the vertical plane of an axis, positive to larger azimuth, and its derivatives."""
        level = max(math.hypot(axis[0], axis[1]), 1e-9)
        return self.above_plane((-axis[1] / level, axis[0] / level, 0.0))

    def above_plane(self, normal: Vector) -> tuple[float, tuple[float, float]]:
        """Signed distance (rad) from the plane with this unit normal, and its derivatives along both axes."""
        h, v = dot(normal, self.left), dot(normal, self.above)
        steepness = max(math.hypot(h, v), 1e-9)
        return math.atan2(dot(normal, self.direction), steepness), (h / steepness, v / steepness)
