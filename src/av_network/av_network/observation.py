"""What is known of a rig, what its measurements added since its last report, and its directions as the trackers use them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MOST_TRACKS = 50  # of one rig: its filter has no more
GATE = 16.0  # squared Mahalanobis distance with two degrees of freedom: 0.03 % of true ones are beyond
UNSTATED = math.radians(0.2)**2  # rad^2, of errors of images that rigs do not state, at first: of a mast's tilt and a lens


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


class RigState(NamedTuple):
    """What is known of a rig.

    Parameters:
        heading (rad), clock (s): to be added to its azimuths and stamps.
        heading_sigma (rad), clock_sigma (s), position_sigma (m): standard deviations, see `RigSettings`.
    """

    heading: float
    clock: float
    heading_sigma: float
    clock_sigma: float
    position_sigma: float


@dataclass(frozen=True, eq=False)
class Observation:
    """What a report says anew of the direction to one target.

    Parameters:
        rig: index of the rig.
        position (3,) (m): of the rig.
        sighting: as it was reported.
        known: of the rig at that time.
        unstated (rad^2): variance of errors that the rig does not state.
    """

    rig: int
    position: NDArray[np.float64]
    sighting: Sighting
    known: RigState
    unstated: float = 0.0

    @cached_property
    def key(self) -> tuple[int, int]:
        """The rig's track: (index of the rig, id)."""
        return self.rig, self.sighting.id

    @cached_property
    def time(self) -> float:
        """Mean capture time (s) by the reference clock."""
        return self.sighting.measured + self.known.clock

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """Azimuth and elevation (2,) (rad) in the world."""
        return np.array([self.sighting.azimuth + self.known.heading, self.sighting.elevation])

    @cached_property
    def covariance(self) -> NDArray[np.float64]:
        """Of the horizontal and vertical error (2, 2) (rad^2), of all kinds."""
        turned = self.known.heading_sigma * math.cos(self.sighting.elevation)
        return self.sighting.covariance + np.diag([self.unstated + turned**2, self.unstated])
