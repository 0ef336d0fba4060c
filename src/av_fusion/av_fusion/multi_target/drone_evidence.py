"""Whether a target is a drone, by all that is seen and heard of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

MEMORY = 20.0  # observations of one target, over which their log-odds are averaged
LEAST = 0.5  # observations, fewer say nothing
PRIOR_LOG_ODDS = 1.0  # of a target before the first observation, as much as one observation
LARGEST_LOG_ODDS = 5.0


class DroneEvidence:
    """The mean of the log-odds of all observations of a target.

    Their errors are those of one object in one detector, hence correlated: ten scores of 0.6 are not the evidence of ten
    independent observations, which their sum would be.
    """

    def __init__(self) -> None:
        self._mean, self._count = PRIOR_LOG_ODDS, 0.0

    @property
    def probability(self) -> float:
        """Probability 0..1 that the target is a drone; NaN without an observation that is probably its own."""
        return 1.0 / (1.0 + math.exp(-self._mean)) if self._count >= LEAST else math.nan

    def note(self, probabilities: Sequence[float], shares: Sequence[float]) -> None:
        """Add observations.

        Parameters:
            probabilities: that each observed object is a drone; NaN where unknown.
            shares: probability of each that it stems from this target.
        """
        for probability, share in zip(probabilities, shares, strict=True):
            if share > 0.0 and not math.isnan(probability):
                bounded = min(max(probability, 1e-3), 1.0 - 1e-3)
                odds = min(max(math.log(bounded / (1.0 - bounded)), -LARGEST_LOG_ODDS), LARGEST_LOG_ODDS)
                self._count = min(self._count + share, MEMORY)
                self._mean += share / (1.0 + self._count) * (odds - self._mean)
