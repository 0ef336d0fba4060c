"""A direction of a rig as the trackers use it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network.report import Sighting

UNSTATED = math.radians(0.2)**2  # rad^2, of errors of images that rigs do not state, at first: of a mast's tilt and a lens


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
    def level(self) -> float:
        """Horizontal angle over that of the azimuth."""
        return math.cos(self.sighting.elevation)

    @cached_property
    def lasting(self) -> NDArray[np.float64]:
        """Variances (2,) (rad^2) of the horizontal and vertical errors that last."""
        return np.array([self.unstated + (self.known.heading_sigma * self.level) ** 2, self.unstated])

    @cached_property
    def covariance(self) -> NDArray[np.float64]:
        """Of the horizontal and vertical error (2, 2) (rad^2), of all kinds."""
        return self.sighting.covariance + np.diag(self.lasting)
