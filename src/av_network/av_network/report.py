"""What a rig tells the others: what its measurements added since its last report."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Sighting(NamedTuple):
    """What the measurements of one target since the rig's last report say: a normal density of its direction.

    Parameters:
        id: of the rig's track.
        azimuth, elevation (rad): in the world by the rig's own heading.
        covariance (2, 2) (rad^2): of the horizontal error (that of the azimuth times cos(elevation)) and of the vertical one.
        measured (s): mean capture time of the measurements, by the rig's clock.
        by_sound: whether they are of sound, which arrives later than light.
        existence: probability that there is such a target.
        drone_probability: probability that it is a drone; NaN while unknown.
        class_id: its most probable class; empty while unknown.
        resolved: whether the direction is known from its mirror image.
    """

    id: int
    azimuth: float
    elevation: float
    covariance: NDArray[np.float64]
    measured: float
    by_sound: bool = False
    existence: float = 1.0
    drone_probability: float = math.nan
    class_id: str = ''
    resolved: bool = True


class Report(NamedTuple):
    """What a rig has measured since its last report.

    Parameters:
        rig: the rig's name.
        time (s): of the newest sighting, by the rig's clock.
        position (3,) (m): of the rig, ENU.
        sightings: the directions.
    """

    rig: str
    time: float
    position: NDArray[np.float64]
    sightings: tuple[Sighting, ...]
