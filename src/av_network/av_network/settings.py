"""What is known beforehand of the rigs of a network, and the datum of its coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.geodesy import geodetic_to_enu


@dataclass(frozen=True)
class RigSettings:
    """What is known beforehand of a rig.

    Parameters:
        name: its namespace, without slashes.
        heading_sigma (rad): standard deviation of the heading that the rig believes.
        clock_sigma (s): standard deviation of its clock's offset from the reference clock; 0 for the rig with that clock.
        position_sigma (m): standard deviation of its position along each axis.
    """

    name: str
    heading_sigma: float = math.radians(3.0)
    clock_sigma: float = 0.05
    position_sigma: float = 0.1


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
    """East, north and up (3,) (m) of a place in the tangent plane at an origin.

    Parameters:
        place: latitude, longitude and altitude.
        origin: of the plane.

    Raises ValueError for coordinates that are not on the globe.
    """
    for each in (place, origin):
        if not (each.known and abs(each.latitude) <= 90.0 and abs(each.longitude) <= 180.0 and abs(each.altitude) < 1e5):
            raise ValueError(f'{tuple(each)} is no latitude, longitude (deg) and altitude (m)')
    return geodetic_to_enu(place, origin)
