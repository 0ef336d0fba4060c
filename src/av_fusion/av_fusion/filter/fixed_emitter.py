"""A source that may be an emitter at a fixed place, and what was heard of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.filter.world_direction import Deviation
from av_fusion.measurement.vectors import Vector, angles

# Means of the normalised innovation and of its square (0 and 1 for a source that does not move); share of a window.
LARGEST_BIAS, LARGEST_SPREAD, SHARE = 0.75, 2.5, 0.05
LARGEST_MOVE = math.radians(4.0)  # between where an emitter was heard first and where it is learnt; closer ones are one
# A bystander was heard from one place for this share of the last seconds, with at most this mean probability of a drone.
HEARD, BYSTANDER = 0.4, 0.15


@dataclass(eq=False)
class Emitter:
    """What may be an emitter at a fixed place.

    Parameters:
        component: its direction in the world; it has no rates.
        first: unit vector to where it was heard first.
        place (m): where the rig was when it was heard last.
        presence: share of the recent time for which it was heard.
        bias, spread: means of the normalised innovation of its direction, and of its square.
        drone: mean probability of the last seconds that it is a drone.
        heard: share of the last seconds for which it was heard.
        since (s): when it was learnt; infinite while it is not.
    """

    component: GaussianComponent
    first: Vector
    place: Vector
    presence: float = 0.0
    bias: float = 0.0
    spread: float = 1.0
    drone: float = 0.0
    heard: float = 0.0
    since: float = math.inf

    @property
    def is_known(self) -> bool:
        """Whether it is learnt."""
        return math.isfinite(self.since)

    @property
    def is_bystander(self) -> bool:
        """Whether what has just been heard there for seconds was no drone."""
        return self.heard > HEARD and self.drone < BYSTANDER * self.heard

    @property
    def is_fixed(self) -> bool:
        """Whether its direction has not changed, as far as its deviations show."""
        return (abs(self.bias) < LARGEST_BIAS and self.spread < LARGEST_SPREAD
                and _azimuth_apart(self.first, self.component.direction) < LARGEST_MOVE)

    def note(self, deviation: Deviation) -> None:
        """Note how a direction of arrival deviates."""
        normalised = deviation.innovation / math.sqrt(deviation.total)
        self.bias += SHARE * (normalised - self.bias)
        self.spread += SHARE * (normalised**2 - self.spread)

    def distrust(self) -> None:
        """Begin anew: it may be a drone, or moves."""
        self.presence, self.bias, self.spread = 0.0, 0.0, 1.0
        self.since, self.first = math.inf, self.component.direction


def _azimuth_apart(one: Vector, other: Vector) -> float:
    """Angle (rad) between two directions as seen from above."""
    return abs(math.remainder(angles(one)[0] - angles(other)[0], math.tau))
