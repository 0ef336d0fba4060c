"""Recent directions in which the camera saw the target."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from math import inf, remainder, tau
from typing import NamedTuple


class Sighting(NamedTuple):
    """Direction of the target in the world.

    Parameters:
        time (s): capture time of the image.
        azimuth, elevation (rad): direction.
        variance (rad^2): variance of the azimuth.
    """

    time: float
    azimuth: float
    elevation: float
    variance: float


class SightingHistory:
    """Interpolates sightings, so that a direction of arrival can be compared with the sighting at its capture time.

    Parameters:
        gap (s): longest time between two sightings that is interpolated.
        keep (s): age up to which sightings are kept.
    """

    def __init__(self, gap: float = 0.4, keep: float = 3.0) -> None:
        self._gap, self._keep = gap, keep
        self._sightings: list[Sighting] = []

    def add(self, sighting: Sighting) -> None:
        """Add a sighting; one that is out of order is ignored."""
        if self._sightings and sighting.time <= self._sightings[-1].time:
            return
        del self._sightings[:bisect_right(self._sightings, (sighting.time - self._keep, inf))]
        self._sightings.append(sighting)

    def at(self, time: float) -> Sighting | None:
        """The direction at `time`, interpolated; None outside the history and in gaps."""
        after = bisect_left(self._sightings, (time,))
        if after in (0, len(self._sightings)):
            return None
        earlier, later = self._sightings[after - 1:after + 1]
        if later.time - earlier.time > self._gap:
            return None
        share = (time - earlier.time) / (later.time - earlier.time)
        azimuth = remainder(earlier.azimuth + share * remainder(later.azimuth - earlier.azimuth, tau), tau)
        return Sighting(time, azimuth, earlier.elevation + share * (later.elevation - earlier.elevation), later.variance)
