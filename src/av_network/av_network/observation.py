"""A direction of a rig as the trackers use it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network.report import Sighting
from av_network.tracklets import bounded


class Observation(NamedTuple):
    """What a report says anew of the direction to one target.

    Parameters:
        rig: index of the rig.
        position (3,) (m): of the rig.
        time (s): by the rig's clock.
        sighting: as it was reported.
        angles (2,) (rad): azimuth and elevation of the equivalent measurement, see `Tracklets`.
        covariance (2, 2) (rad^2): of its horizontal and vertical error.
        anew: whether the rig's track has no earlier reports, or has jumped.
    """

    rig: int
    position: NDArray[np.float64]
    time: float
    sighting: Sighting
    angles: NDArray[np.float64]
    covariance: NDArray[np.float64]
    anew: bool

    @property
    def key(self) -> tuple[int, int]:
        """The rig's track: (index of the rig, id)."""
        return self.rig, self.sighting.id

    def as_reported(self) -> Observation:
        """The direction with all that the rig knows of it, for a target that has not used it before."""
        sighting = self.sighting
        return self._replace(angles=np.array([sighting.azimuth, sighting.elevation]), covariance=bounded(sighting.covariance))
