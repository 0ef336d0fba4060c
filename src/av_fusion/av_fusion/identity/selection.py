"""Which of several targets is followed: one utility, one threshold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from av_common.track import Target, Track

MARGIN = 1.5  # of the utility of another target over that of the followed one, from which it is followed
CERTAIN = 0.9  # probability of a drone above which two targets are equally worth following


def _angle(track: Track) -> float:
    return math.acos(min(max(math.cos(track.azimuth) * math.cos(track.elevation), -1.0), 1.0))


def _sigma(track: Track) -> float:
    return math.sqrt(max(track.covariance_world[0], 1e-8))


def _rate(track: Track) -> float:
    return math.hypot(track.azimuth_world_rate * math.cos(track.elevation_world), track.elevation_world_rate)


# What is to be small by policy (rad, or rad/s for `closing`: a target on a collision course has a constant bearing).
POLICIES: Mapping[str, Callable[[Track], float]] = {
    'certain': _sigma, 'centre': _angle, 'closing': lambda track: _rate(track) + _sigma(track)}


class Selection:
    """Chooses the target by its utility, and keeps it until another one has clearly more.

    The utility is the probability that there is such a target, on the side where its track is, times the odds that it is a
    drone, over what the policy wants small. Only targets that are drones with at least the probability `threshold` are
    followed, or those that nothing judges.

    Policies: `certain` (small variance), `centre` (closest to the body's x axis), `closing` (most constant bearing).

    Attributes:
        wanted: id of the target that a person wants, as long as it is tracked; 0 for none.

    Parameters:
        policy: one of POLICIES.
        threshold: probability of a drone from which a target is followed.

    Raises ValueError for another policy.
    """

    def __init__(self, policy: str, threshold: float) -> None:
        if policy not in POLICIES:
            raise ValueError(f'policy {policy!r}, expected one of {", ".join(POLICIES)}')
        self._small, self.threshold = POLICIES[policy], threshold
        self._followed = self.wanted = 0

    def is_followed(self, target: Target) -> bool:
        """Whether a target is one to follow."""
        return not target.drone_probability < self.threshold

    def choose(self, targets: Sequence[Target]) -> int:
        """The id of the target to follow of all that are tracked, 0 where there is none."""
        if self.wanted in [target.id for target in targets]:
            self._followed = self.wanted
            return self._followed
        self.wanted = 0
        utility = {target.id: self._utility(target) for target in targets if self.is_followed(target)}
        best = max(utility, key=utility.__getitem__, default=0)
        if self._followed not in utility or utility[best] > MARGIN * utility[self._followed]:
            self._followed = best
        return self._followed

    def _utility(self, target: Target) -> float:
        """Probability of a drone counts up to CERTAIN, and is even while nothing judges."""
        drone = 0.5 if math.isnan(target.drone_probability) else min(target.drone_probability, CERTAIN)
        side = 1.0 if target.track.resolved else target.track.hemisphere_probability
        return target.existence * side * drone / (1.0 - drone) / (self._small(target.track) + math.radians(1.0))
