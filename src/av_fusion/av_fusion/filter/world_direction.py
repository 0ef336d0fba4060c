"""A measured direction in the world, and how it deviates from what a component predicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from av_fusion.filter.past_state import PastState
from av_fusion.measurement.measurements import Detection, Hypothesis
from av_fusion.measurement.vectors import Rows, Vector, cross, dot, tangents, turned
from av_fusion.measurement.vectors import direction as direction_of

TOLERANCE = math.radians(3.0)  # of an elevation beyond its variance: targets climb faster than they turn


class Deviation(NamedTuple):
    """A scalar measurement compared with a prediction.

    Parameters:
        row: derivatives of the measured value with respect to the direction across and up.
        innovation: measured minus predicted value.
        total: variance of the innovation.
        noise: the measurement's part of it.
        tolerance: variance by which larger innovations are expected.
    """

    row: tuple[float, float]
    innovation: float
    total: float
    noise: float
    tolerance: float = 0.0

    @property
    def distance(self) -> float:
        """Square of the innovation in standard deviations."""
        return self.innovation**2 / (self.total + self.tolerance)


def distance(deviations: Sequence[Deviation]) -> float:
    """Square of the distance of a measurement from a prediction, in standard deviations."""
    return sum([deviation.distance for deviation in deviations])


class WorldDirection(NamedTuple):
    """A measured direction.

    Parameters:
        vector: unit vector; with an unknown elevation, in the sensor's level plane.
        left: unit vector to larger azimuths of the sensor.
        across_variance, up_variance (rad^2): of the errors along `left` and perpendicular to it; infinite where the
            elevation is unknown.
    """

    vector: Vector
    left: Vector
    across_variance: float
    up_variance: float

    @classmethod
    def of(cls, measured: Detection | Hypothesis, attitude: Rows, extra: float = 0.0) -> WorldDirection:
        """A direction in the body frame turned into the world; `extra` (rad^2) is added to its variance across."""
        known = math.isfinite(measured.elevation_variance)
        elevation = measured.elevation if known else 0.0
        return cls(turned(attitude, direction_of(measured.azimuth, elevation)),
                   turned(attitude, tangents(measured.azimuth, elevation)[0]), measured.across_variance + extra,
                   measured.elevation_variance)

    @property
    def is_known(self) -> bool:
        """Whether it has an elevation."""
        return math.isfinite(self.up_variance)

    def deviations(self, past: PastState) -> tuple[Deviation, ...]:
        """Deviations from a component: across, and up where the elevation is known."""
        h, v = dot(self.left, past.left), dot(self.left, past.above)
        if not self.is_known:
            return (self._beside(past),)
        norm = max(math.hypot(h, v), 1e-9)
        across, up = (h / norm, v / norm), (-v / norm, h / norm)
        x, y = past.offset(self.vector)
        return (Deviation(across, across[0] * x + across[1] * y, past.variance(across) + self.across_variance,
                          self.across_variance),
                Deviation(up, up[0] * x + up[1] * y, past.variance(up) + self.up_variance, self.up_variance, TOLERANCE**2))

    def _beside(self, past: PastState) -> Deviation:
        """The deviation from the half of a great circle through the sensor's vertical, on which all elevations lie."""
        distance, row = past.above_plane(self.left)
        if dot(self.vector, past.direction) < 0.0:  # on the other half
            distance = math.copysign(math.pi, distance) - distance
        level = 1.0 - dot(cross(self.vector, self.left), past.direction) ** 2
        noise = self.across_variance * max(level, 0.01)
        return Deviation(row, -distance, past.variance(row) + noise, noise)
