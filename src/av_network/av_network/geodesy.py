"""Geodetic coordinates (WGS 84) and a local tangent plane."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SEMI_MAJOR_M, FLATTENING = 6378137.0, 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)


class Datum(NamedTuple):
    """The origin of a tangent plane: latitude, longitude (deg), altitude above the ellipsoid (m); NaN where there is none."""

    latitude: float = math.nan
    longitude: float = math.nan
    altitude: float = math.nan

    @property
    def known(self) -> bool:
        """Whether there is one."""
        return all(math.isfinite(value) for value in self)


def to_enu(place: Datum, origin: Datum) -> NDArray[np.float64]:
    """East, north and up (3,) (m) of a place in the tangent plane at an origin (NIMA TR8350.2, section 4).

    Parameters:
        place: latitude, longitude and altitude.
        origin: of the plane.

    Raises ValueError for coordinates that are not on the globe.
    """
    for each in (place, origin):
        if not (each.known and abs(each.latitude) <= 90.0 and abs(each.longitude) <= 180.0 and abs(each.altitude) < 1e5):
            raise ValueError(f'{tuple(each)} is no latitude, longitude (deg) and altitude (m)')
    latitude, longitude = math.radians(origin.latitude), math.radians(origin.longitude)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    up = np.array([cosine * math.cos(longitude), cosine * math.sin(longitude), sine])
    return np.stack([east, np.cross(up, east), up]) @ (_geocentric(place) - _geocentric(origin))


def _geocentric(place: Datum) -> NDArray[np.float64]:
    latitude, longitude = math.radians(place.latitude), math.radians(place.longitude)
    radius = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    level = (radius + place.altitude) * math.cos(latitude)
    return np.array([level * math.cos(longitude), level * math.sin(longitude),
                     (radius * (1.0 - ECCENTRICITY_SQUARED) + place.altitude) * math.sin(latitude)])
