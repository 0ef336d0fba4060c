"""Recent directions in which the camera saw the target."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import NamedTuple

from av_fusion.measurement.vectors import Rows, Vector, combined, dot, turned

_TIME = attrgetter('time')


class Sighting(NamedTuple):
    """Direction of the target in the world.

    Parameters:
        time (s): capture time of the image.
        direction: unit vector.
        variance (rad^2): variance of the direction.
    """

    time: float
    direction: Vector
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
        del self._sightings[:bisect_right(self._sightings, sighting.time - self._keep, key=_TIME)]
        self._sightings.append(sighting)

    def at(self, time: float) -> Sighting | None:
        """The direction at `time`, interpolated; None outside the history and in gaps."""
        after = bisect_left(self._sightings, time, key=_TIME)
        if after in (0, len(self._sightings)):
            return None
        earlier, later = self._sightings[after - 1:after + 1]
        if later.time - earlier.time > self._gap:
            return None
        share = (time - earlier.time) / (later.time - earlier.time)
        mean = combined(1.0 - share, earlier.direction, share, later.direction)
        length = max(math.sqrt(dot(mean, mean)), 1e-9)
        return Sighting(time, combined(1.0 / length, mean, 0.0, mean), later.variance)

    def turn_world(self, rows: Rows) -> None:
        """Turn all sightings with the world, where the rig's attitude was corrected."""
        self._sightings = [s._replace(direction=turned(rows, s.direction)) for s in self._sightings]
