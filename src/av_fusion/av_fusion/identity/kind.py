"""What a target is, by all that is heard and seen of it: a drone, something else, or an emitter at a fixed place."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.track import Source

# Prior probabilities of a drone, of something else that moves, and of a fixed emitter: what is heard around a rig that looks
# for drones is one as often as not, and one source in four of the others is a fan or generator.
DRONE, FIXED = 0.5, 0.125
OWN = 0.05  # prior probability that what is heard is none of these, but a part of the rig that turns with it
# Logarithm of how much more often a detector of drones marks a drone than something else: what is seen is a drone with a
# probability of 0.6 before its scores count.
SEEN = 0.4
LEAST_LOOKS = 1.0  # of the camera; a share of one may be another target's
# What moves stays at one place for HOVER_S on average; a share HOVERING of drones does for the whole flight.
HOVER_S, HOVERING = 60.0, 0.03
# Correlation of the log-likelihood ratios of one target by one sensor: the errors of successive looks are those of one object
# and one model. With it n looks count as n / (1 + (n - 1) CORRELATION) independent ones (Kish, Survey Sampling, 1965, 5.4).
CORRELATION = 0.4
SUREST = 0.9933  # probability of a drone by one look; no model is surer than its training data
# A low score of a detection says that little of the object can be seen, rather than that it is something else.
LEAST_SEEN = -1.0


class Kind:
    """The discrete state of a target with its probabilities, by Bayes' rule from one prior.

    Attributes:
        static_s (s): for how long the target has been heard from one place in the world.
    """

    def __init__(self) -> None:
        self.static_s = 0.0
        self._sums = {Source.SOUND: (0.0, 0.0), Source.SIGHT: (0.0, 0.0)}  # of log-likelihood ratios, and number of looks

    @property
    def drone(self) -> float:
        """Probability that the target is a drone, if it does not turn with the rig; NaN before the first look."""
        return self._probabilities()[0]

    @property
    def is_fixed(self) -> bool:
        """Whether it is most probably a fixed emitter."""
        drone, other, fixed = self._probabilities()
        return fixed > max(drone, other)

    def _probabilities(self) -> tuple[float, float, float]:
        """Probabilities of a drone, something else that moves, and a fixed emitter; NaN before the first look."""
        if not self._sums[Source.SOUND][1] and self._sums[Source.SIGHT][1] < LEAST_LOOKS:
            return math.nan, math.nan, math.nan
        stays = HOVERING + (1.0 - HOVERING) * math.exp(-self.static_s / HOVER_S)  # probability of what moves to stay so long
        weights = DRONE * stays * math.exp(self._ratio()), (1.0 - DRONE - FIXED) * stays, FIXED
        return weights[0] / sum(weights), weights[1] / sum(weights), weights[2] / sum(weights)

    def _ratio(self) -> float:
        """Logarithm of the likelihood ratio of all looks, of a drone over something else."""
        looks = sum([total / (1.0 + (count - 1.0) * CORRELATION) if count > 1.0 else total
                     for total, count in self._sums.values()])
        return looks + SEEN * min(self._sums[Source.SIGHT][1], 1.0)

    def fits(self, probabilities: Sequence[float]) -> NDArray[np.float64]:
        """Likelihood (n,) of what each source sounds like if it is this target, relative to any source; 1 where not known.

        Parameters:
            probabilities: that each source is a drone, by this window alone with an even prior; NaN where unknown.
        """
        own, heard = self.drone, np.array(probabilities)
        fits = 2.0 * (own * heard + (1.0 - own) * (1.0 - heard))
        return np.where(np.isnan(fits), 1.0, fits)

    def note(self, sensor: Source, probabilities: Sequence[float], shares: Sequence[float]) -> None:
        """Add looks.

        Parameters:
            sensor: SOUND or SIGHT.
            probabilities: that each observed object is a drone, by this look alone with an even prior; NaN where unknown.
            shares: effective number of looks of each at this target: at most 1.
        """
        total, count = self._sums[sensor]
        for probability, share in zip(probabilities, shares, strict=True):
            if share > 0.0 and not math.isnan(probability):
                bounded = min(max(probability, 1.0 - SUREST), SUREST)
                ratio = math.log(bounded / (1.0 - bounded))
                total += share * (max(ratio, LEAST_SEEN) if sensor == Source.SIGHT else ratio)
                count += share
        self._sums[sensor] = total, count
