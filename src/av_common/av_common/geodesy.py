"""Positions on the ellipsoid of WGS84, and relative to a place on it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

SEMI_MAJOR_M, FLATTENING = 6378137.0, 1.0 / 298.257223563  # WGS84, NIMA TR8350.2
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
ITERATIONS = 5  # below 1e-9 m up to 10 km of altitude


def to_ecef(latitude: float, longitude: float, altitude: float) -> NDArray:
    """Earth-centred, earth-fixed position (m, (3,)).

    Parameters:
        latitude, longitude (deg): WGS84.
        altitude (m): above the ellipsoid.
    """
    phi, lam = math.radians(latitude), math.radians(longitude)
    radius = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_2 * math.sin(phi) ** 2)
    across = (radius + altitude) * math.cos(phi)
    up = (radius * (1.0 - ECCENTRICITY_2) + altitude) * math.sin(phi)
    return np.array([across * math.cos(lam), across * math.sin(lam), up])


def from_ecef(position: ArrayLike) -> tuple[float, float, float]:
    """Latitude, longitude (deg) and altitude (m) of an earth-centred, earth-fixed position (m, (3,)), by Bowring's iteration.

    Source: B. R. Bowring, Survey Review 23 (1976) 323.
    """
    x, y, z = np.asarray(position, float)
    across, minor = math.hypot(x, y), SEMI_MAJOR_M * (1.0 - FLATTENING)
    second = ECCENTRICITY_2 / (1.0 - ECCENTRICITY_2)
    reduced = math.atan2(z * SEMI_MAJOR_M, across * minor)
    for _ in range(ITERATIONS):
        phi = math.atan2(z + second * minor * math.sin(reduced) ** 3,
                         across - ECCENTRICITY_2 * SEMI_MAJOR_M * math.cos(reduced) ** 3)
        reduced = math.atan2((1.0 - FLATTENING) * math.sin(phi), math.cos(phi))
    radius = SEMI_MAJOR_M * math.sqrt(1.0 - ECCENTRICITY_2 * math.sin(phi) ** 2)
    return math.degrees(phi), math.degrees(math.atan2(y, x)), across * math.cos(phi) + z * math.sin(phi) - radius


def enu_axes(latitude: float, longitude: float) -> NDArray:
    """Unit vectors to the east, north and up at a place (deg), as rows (3, 3) in earth-centred, earth-fixed coordinates."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    east = [-math.sin(lam), math.cos(lam), 0.0]
    north = [-math.sin(phi) * math.cos(lam), -math.sin(phi) * math.sin(lam), math.cos(phi)]
    up = [math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)]
    return np.array([east, north, up])


def enu_to_geodetic(offset: ArrayLike, origin: tuple[float, float, float]) -> tuple[float, float, float]:
    """Latitude, longitude (deg) and altitude (m) of a point.

    Parameters:
        offset (m, (3,)): of the point to the east, north and up of the origin.
        origin: latitude, longitude (deg) and altitude (m).
    """
    latitude, longitude, altitude = origin
    axes = enu_axes(latitude, longitude)
    return from_ecef(to_ecef(latitude, longitude, altitude) + axes.T @ np.asarray(offset, float))


def geodetic_to_enu(point: tuple[float, float, float], origin: tuple[float, float, float]) -> NDArray:
    """Offset (m, (3,)) of a point to the east, north and up of the origin.

    Parameters:
        point, origin: latitude, longitude (deg) and altitude (m).
    """
    axes = enu_axes(origin[0], origin[1])
    return axes @ (to_ecef(*point) - to_ecef(*origin))
