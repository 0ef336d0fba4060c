"""Whether a target is a drone, by all that is seen and heard of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.track import Source

DRONE = 0.5  # probability of being a drone below which a target, or a sound, is that of something else
MEMORY = 20.0  # observations of one target, over which their log-odds are averaged
LEAST = 0.5  # observations, fewer say nothing
PRIOR_LOG_ODDS = 1.0  # of a target before the first observation, as much as one observation
LARGEST_LOG_ODDS = 5.0
LEAST_AGREEMENT = 0.2  # likelihood of equal kinds below which a sound is that of another source
UNSURE = 1.0  # difference of log-odds within which a drone and a bystander sound alike
# A low score says that little of the object can be seen, as in fog, rather than that it is something else.
LEAST_LOG_ODDS = {Source.SOUND: -5.0, Source.SIGHT: -1.0}
CLEAR = 0.5  # visibility of an image from which low scores count in full; with less they count in proportion to it


class DroneEvidence:
    """The mean of the log-odds of all observations by one sensor, summed over the sensors.

    Errors of one sensor are those of one object in one detector, hence correlated: ten scores of 0.6 are not the evidence of
    ten independent observations, which their sum would be. Those of microphones and camera are independent.
    """

    def __init__(self) -> None:
        self._sums = {Source.SOUND: (0.0, 0.0), Source.SIGHT: (0.0, 0.0)}  # of log-odds and of shares

    @property
    def probability(self) -> float:
        """Probability 0..1 that the target is a drone; NaN without an observation that is probably its own."""
        observed = sum(count for _, count in self._sums.values())
        if observed < LEAST:
            return math.nan
        odds = PRIOR_LOG_ODDS / (1.0 + observed) + sum(total / (1.0 + count) for total, count in self._sums.values())
        return 1.0 / (1.0 + math.exp(-odds))

    def fits(self, probabilities: Sequence[float]) -> NDArray[np.float64]:
        """Whether what is heard is of the kind of this target, 0 or 1 (n,); also where either is not known.

        Windows overlap, and one source sounds alike for seconds: the probabilities are no independent evidence by which a
        drone that was lost for a moment could be told from a talker close to it. A decision is, unless both are close to
        even odds: what is hardly told from a bystander sounds like either from one window to the next.

        Parameters:
            probabilities: that each source is a drone; NaN where unknown.
        """
        own = log_odds(self.probability)
        heard = np.array([log_odds(probability) for probability in probabilities])
        alike = ((heard >= 0.0) == (own >= 0.0)) | (np.abs(heard - own) < UNSURE)
        return np.where(np.isnan(heard) | math.isnan(own) | alike, 1.0, 0.0)

    def agreement(self, probabilities: Sequence[float]) -> NDArray[np.float64]:
        """Likelihood (n,) of what is heard if it stems from this target, relative to any source; 1 where either is not known.

        It is that of equal kinds, and 0 where both are nearly certain and differ.

        Parameters:
            probabilities: that each source is a drone; NaN where unknown.
        """
        own, heard = self.probability, np.asarray(probabilities, dtype=float)
        likelihoods = np.nan_to_num(2.0 * (own * heard + (1.0 - own) * (1.0 - heard)), nan=1.0)
        return np.where(likelihoods < LEAST_AGREEMENT, 0.0, likelihoods)

    def note(self, sensor: Source, probabilities: Sequence[float], shares: Sequence[float], visibility: float = 1.0) -> None:
        """Add observations.

        Parameters:
            sensor: SOUND or SIGHT.
            probabilities: that each observed object is a drone; NaN where unknown.
            shares: probability of each that it stems from this target.
            visibility: 0..1, of the image: a score that fog may have lowered does not speak against a drone.
        """
        total, count = self._sums[sensor]
        for probability, share in zip(probabilities, shares, strict=True):
            odds = min(max(log_odds(probability), LEAST_LOG_ODDS[sensor]), LARGEST_LOG_ODDS)
            told = share if odds > 0.0 else share * min(visibility / CLEAR, 1.0)
            if told > 0.0 and not math.isnan(odds):
                kept = min(1.0, MEMORY / (count + told))
                total, count = kept * (total + told * odds), kept * (count + told)
        self._sums[sensor] = total, count


def log_odds(probability: float) -> float:
    """Log-odds of a probability, of which none counts as certain; NaN of NaN."""
    bounded = min(max(probability, 1e-3), 1.0 - 1e-3)
    return math.nan if math.isnan(bounded) else math.log(bounded / (1.0 - bounded))
