"""What is known of a supposed target."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from av_network.lone_track import LoneTrack
from av_network.observation import GATE, Observation, Sighting

NIS_MEMORY = 10  # observations over which the consistency is averaged
EXPECTED_NIS = 2.0  # of two degrees of freedom
SUPPORT_S = 1.5  # since a track's newest observation, for which its rig counts as observing the target: six reports
WELL_SUPPORTED = 3  # rigs, from which a target's tracks are not thought of otherwise


class Member(NamedTuple):
    """A rig's track of a target.

    Parameters:
        sighting: its newest one that was used.
        last (s): the time of that, by the reference clock.
        gain: what it has added to the target's score.
        alone: the track as a target of its own.
    """

    sighting: Sighting
    last: float
    gain: float
    alone: LoneTrack

    @property
    def id(self) -> int:
        """Of the track."""
        return self.sighting.id


@dataclass
class NetworkTarget:
    """A target that is supposed behind tracks of several rigs: a candidate until it is confirmed.

    Parameters:
        started (s): time of its first observation.
        measured (s): time of its newest observation.
        id: counted up; 0 for a candidate.
        odds: logarithm of the odds of the best global hypothesis with it over that without it.
        members: the rigs' tracks of it by index of the rig.
        nis: running mean of the normalised innovation squared of its observations.
        refuted: whether an observation cannot stem from it.
        told: probability that it is a drone, by each rig that has told one; kept when that rig follows something else.
    """

    started: float
    measured: float
    id: int = 0
    odds: float = 0.0
    members: dict[int, Member] = field(default_factory=dict)
    nis: float = EXPECTED_NIS
    refuted: bool = False
    told: dict[int, float] = field(default_factory=dict)

    @property
    def confirmed(self) -> bool:
        """Whether it is a target rather than a candidate."""
        return self.id > 0

    def score(self, keys: set[tuple[int, int]]) -> float:
        """Logarithm of the probability that these members are one target over that they are different ones."""
        return sum(member.gain for rig, member in self.members.items() if (rig, member.id) in keys)

    def tracks(self, since: float = -math.inf) -> set[tuple[int, int]]:
        """The rigs' tracks with observations since a time (s): (index of the rig, id)."""
        return {(rig, member.id) for rig, member in self.members.items() if member.last >= since}

    def member(self, rig: int, track: int) -> Member | None:
        """The member that is a rig's track; None if there is none."""
        found = self.members.get(rig)
        return found if found is not None and found.id == track else None

    def note(self, one: Observation, time: float, nis: float, gain: float, alone: LoneTrack) -> None:
        """Note an observation that was used.

        Parameters:
            one: the observation.
            time (s): by the reference clock.
            nis: normalised innovation squared.
            gain: logarithm of its density over that if it stemmed from another target.
            alone: the rig's track as that other target.
        """
        before = self.member(one.rig, one.sighting.id)
        if math.isfinite(one.sighting.drone_probability):
            self.told[one.rig] = one.sighting.drone_probability
        self.members[one.rig] = Member(one.sighting, time, gain + (before.gain if before else 0.0), alone)
        self.measured = max(self.measured, time)
        self.nis += (min(nis, GATE) - self.nis) / NIS_MEMORY

    @property
    def drone_probability(self) -> float:
        """Probability that it is a drone, by the mean of the log-odds that its rigs have told last; NaN while unknown."""
        return float(expit(np.mean(logit(np.clip(list(self.told.values()), 0.01, 0.99))))) if self.told else math.nan

    @property
    def class_id(self) -> str:
        """The class that most of its rigs have named last; empty while unknown."""
        named = Counter(member.sighting.class_id for member in self.members.values() if member.sighting.class_id)
        return named.most_common(1)[0][0] if named else ''


class TargetState(NamedTuple):
    """A target at a time.

    Parameters:
        target: what is known besides its state.
        existence: probability 0..1 that there is such a target.
        mean (6,), covariance (6, 6): position (m) and velocity (m/s) in ENU.
        rigs: indices of the rigs with recent observations.
        positioned: whether its position is known: precise, and consistent with its directions.
    """

    target: NetworkTarget
    existence: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    rigs: tuple[int, ...]
    positioned: bool


def membership(hypotheses: Sequence[NetworkTarget], observations: Sequence[Observation]) -> NDArray[np.bool_]:
    """Whether (n, m) each of m observations is of a rig's track that is a member of each of n hypotheses."""
    rigs = sorted({one.rig for one in observations})
    ids = np.array([[each.members[rig].id if rig in each.members else -1 for rig in rigs] for each in hypotheses], int)
    columns = np.searchsorted(rigs, [one.rig for one in observations])
    return np.asarray(ids.reshape(-1, len(rigs))[:, columns] == [one.sighting.id for one in observations])
