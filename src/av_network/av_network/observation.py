"""A direction of a rig as the trackers use it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network.report import Sighting


class Observation(NamedTuple):
    """What a report says anew of the direction to one target.

    Parameters:
        rig: index of the rig.
        position (3,) (m): of the rig.
        sighting: as it was reported.
    """

    rig: int
    position: NDArray[np.float64]
    sighting: Sighting

    @property
    def key(self) -> tuple[int, int]:
        """The rig's track: (index of the rig, id)."""
        return self.rig, self.sighting.id

    @property
    def time(self) -> float:
        """Mean capture time (s) by the rig's clock."""
        return self.sighting.measured

    @property
    def angles(self) -> NDArray[np.float64]:
        """Azimuth and elevation (2,) (rad)."""
        return np.array([self.sighting.azimuth, self.sighting.elevation])

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of the horizontal and vertical error (2, 2) (rad^2)."""
        return self.sighting.covariance
