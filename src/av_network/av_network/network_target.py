"""What is known of a target besides its state."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from av_network.report import Sighting

SIGHT_MEMORY = 20  # sightings over which the evidence for a drone is averaged
NIS_MEMORY = 10  # observations over which the consistency is averaged
EXPECTED_NIS = 2.0  # of two degrees of freedom


@dataclass
class NetworkTarget:
    """A target that is tracked by the network.

    Parameters:
        id: counted up.
        born (s): when it was confirmed.
        measured (s): time of its newest observation.
        members: the rigs' tracks of it by index of the rig, with the time of their newest observation.
        nis: running mean of the normalised innovation squared of its observations.
        classes: how often the rigs named each class.
        log_odds_drone: running mean of the logarithms of the odds that the rigs report for a drone; NaN while unknown.
        duplicate_since (s): since when it may be the same target as an older one; inf if it is not.
    """

    id: int
    born: float
    measured: float
    members: dict[int, tuple[int, float]] = field(default_factory=dict)
    nis: float = EXPECTED_NIS
    classes: Counter[str] = field(default_factory=Counter)
    log_odds_drone: float = math.nan
    duplicate_since: float = math.inf

    def note(self, rig: int, sighting: Sighting, time: float, nis: float) -> None:
        """Note an observation that was used.

        Parameters:
            rig: index of the rig.
            sighting: what it reported.
            time (s): by the reference clock.
            nis: normalised innovation squared.
        """
        self.members[rig] = (sighting.id, time)
        self.measured = max(self.measured, time)
        self.nis += (min(nis, 16.0) - self.nis) / NIS_MEMORY
        if sighting.class_id:
            self.classes[sighting.class_id] += 1
        if 0.0 <= sighting.drone_probability <= 1.0:
            p = min(max(sighting.drone_probability, 0.01), 0.99)
            odds = math.log(p / (1.0 - p))
            known = math.isfinite(self.log_odds_drone)
            self.log_odds_drone = self.log_odds_drone + (odds - self.log_odds_drone) / SIGHT_MEMORY if known else odds

    @property
    def drone_probability(self) -> float:
        """Probability that it is a drone, by the mean of the rigs' log-odds; NaN while unknown."""
        return 1.0 / (1.0 + math.exp(-self.log_odds_drone)) if math.isfinite(self.log_odds_drone) else math.nan

    @property
    def class_id(self) -> str:
        """The class that was named most often; empty while unknown."""
        return self.classes.most_common(1)[0][0] if self.classes else ''
