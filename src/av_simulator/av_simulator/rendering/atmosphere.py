"""Extinction of light in the air: fog, rain, clouds of smoke."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf


@dataclass(frozen=True)
class Cloud:
    """A Gaussian cloud of smoke or fog at one instant.

    Parameters:
        centre (m, (3,)): centre in ENU.
        radius (m): standard deviation of the density.
        density (1/m): extinction coefficient at the centre.
    """

    centre: NDArray
    radius: float
    density: float

    def optical_depth(self, origin: NDArray, directions: NDArray, distance: NDArray) -> NDArray:
        """Integral (n,) of the extinction coefficient along rays.

        Parameters:
            origin (m, (3,)): common origin of the rays in ENU.
            directions ((n, 3)): unit vectors in ENU.
            distance (m, (n,)): lengths of the rays.
        """
        away = (self.centre - origin).astype(directions.dtype)
        closest = directions @ away
        offset2 = np.maximum(away @ away - closest**2, 0.0)
        depth = np.zeros(len(directions), directions.dtype)
        near = offset2 < (4.0 * self.radius) ** 2
        scale = math.sqrt(2.0) * self.radius
        span = erf((distance[near] - closest[near]) / scale) + erf(closest[near] / scale)
        peak = self.density * self.radius * math.sqrt(math.pi / 2.0)
        depth[near] = peak * np.exp(-offset2[near] / scale**2) * span
        return depth


@dataclass(frozen=True)
class Atmosphere:
    """The air at one instant. The transmission of a path is exp(-optical depth) (Beer-Lambert).

    Parameters:
        fog (1/m): extinction coefficient of fog.
        rain_mm_h (mm/h): rain; R mm/h adds 1.076 R^0.67 dB/km (Carbonneau and Wisely 1998).
        clouds: clouds of smoke or fog.
    """

    fog: float = 0.0
    rain_mm_h: float = 0.0
    clouds: tuple[Cloud, ...] = field(default_factory=tuple)

    @property
    def rain_extinction(self) -> float:
        """Extinction coefficient (1/m) of the rain alone."""
        return 1.076 * self.rain_mm_h**0.67 * math.log(10.0) / 10.0 / 1000.0

    def optical_depth(self, origin: ArrayLike, directions: ArrayLike, distance: ArrayLike) -> NDArray:
        """Optical depths (n,) of rays, in the precision of `directions`.

        Parameters:
            origin (m, (3,)): common origin of the rays in ENU.
            directions ((n, 3)): unit vectors in ENU.
            distance (m, (n,)): lengths of the rays.
        """
        origin, directions = np.asarray(origin), np.asarray(directions)
        distance = np.asarray(distance, directions.dtype)
        depth = (self.fog + self.rain_extinction) * distance
        for cloud in self.clouds:
            depth = depth + cloud.optical_depth(origin, directions, distance)
        return depth.astype(directions.dtype, copy=False)

    def transmission(self, origin: ArrayLike, point: ArrayLike) -> float:
        """Transmission (0 to 1) of the path between two points (m, (3,)) in ENU."""
        away = np.asarray(point, float) - origin
        distance = np.linalg.norm(away)
        if distance == 0.0:
            return 1.0
        return float(np.exp(-self.optical_depth(origin, (away / distance)[np.newaxis], [distance])[0]))
