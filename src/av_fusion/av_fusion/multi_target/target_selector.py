"""Which of several targets is followed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from av_common.track import Target, Track
from av_fusion.multi_target.drone_evidence import log_odds

CERTAIN = 0.9  # existence probability from which another target than the one before is followed
MARGIN = 1.5  # of the urgency of another target over that of the followed one, from which it is followed
DWELL_S = 1.0  # for which it must be so
# A target whose log-odds of being a drone, LARGEST_LIKENESS at most, are so far below those of another one is a bystander.
LESS_LIKE, LARGEST_LIKENESS = 1.0, 3.0


def _angle(track: Track) -> float:
    return math.acos(min(max(math.cos(track.azimuth) * math.cos(track.elevation), -1.0), 1.0))


def _sigma(track: Track) -> float:
    return math.sqrt(max(track.covariance_world[0], 1e-8))


# Urgency of a target by policy. A target on a collision course has a constant bearing.
POLICIES: Mapping[str, Callable[[Target], float]] = {
    'certain': lambda target: target.existence / (_sigma(target.track) + math.radians(1.0)),
    'centre': lambda target: target.existence / (_angle(target.track) + math.radians(1.0)),
    'closing': lambda target: target.existence / (
        math.hypot(target.track.azimuth_world_rate * math.cos(target.track.elevation_world), target.track.elevation_world_rate)
        + _sigma(target.track) + math.radians(1.0)),
}


class TargetSelector:
    """Chooses the target by a policy, and keeps it until another one is clearly more urgent for some time.

    Another one is followed only when it exists with a probability of CERTAIN: a lost one leaves reflections. One beside which
    another is clearly more like a drone is followed only where it is wanted.

    Policies: `certain` (small variance), `centre` (closest to the body's x axis), `closing` (most constant bearing).

    Parameters:
        policy: one of POLICIES.

    Raises ValueError for another policy.
    """

    def __init__(self, policy: str) -> None:
        if policy not in POLICIES:
            raise ValueError(f'policy {policy!r}, expected one of {", ".join(POLICIES)}')
        self._policy = policy
        self._followed = self._wanted = self._rival = 0
        self._rival_since = math.inf

    def want(self, identifier: int) -> None:
        """Follow the target with this id while it is tracked; 0: by the policy."""
        self._wanted = identifier

    def choose(self, time: float, targets: Sequence[Target]) -> int:
        """The id of the target to follow, 0 where there is none.

        Parameters:
            time (s): the present.
            targets: of which one is followed.
        """
        urgency = {target.id: POLICIES[self._policy](target) for target in targets}
        if self._wanted in urgency:
            self._followed = self._wanted
            return self._followed
        self._wanted = 0
        alike = _alike(targets)
        urgency = {target.id: urgency[target.id] for target in alike}
        if self._followed:    # the first one is followed as soon as it is reported
            urgency = {target.id: urgency[target.id] for target in alike
                       if target.id == self._followed or target.existence >= CERTAIN}
        rival = max(urgency, key=urgency.__getitem__, default=0)
        if not urgency:
            return 0
        if self._followed not in urgency:
            self._followed = rival
        elif urgency[rival] <= MARGIN * urgency[self._followed]:
            self._rival = 0
        elif rival != self._rival or not time >= self._rival_since:
            self._rival, self._rival_since = rival, time
        elif time - self._rival_since >= DWELL_S:
            self._followed = rival
        return self._followed


def _alike(targets: Sequence[Target]) -> list[Target]:
    """The targets that are as like a drone as the one that is most like one, of those that exist; and what is not judged."""
    likeness = {target.id: min(log_odds(target.drone_probability), LARGEST_LIKENESS) for target in targets}
    most = max((likeness[target.id] for target in targets if target.existence >= CERTAIN
                and not math.isnan(target.drone_probability)), default=-math.inf)
    return [target for target in targets if not likeness[target.id] < most - LESS_LIKE]
