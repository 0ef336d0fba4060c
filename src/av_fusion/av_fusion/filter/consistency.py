"""Whether innovations are as large as the filter expects, and by how much the variances that it publishes are too large."""

from __future__ import annotations

import math

LARGEST_NIS = 9.0  # bound of a normalised innovation squared, so that an outlier is not remembered for long
MEMORY, SHORT_MEMORY = 16.0, 2.0  # effective number of independent measurements that the averages remember
LEAST = 0.1  # share of the variance that is due to errors which innovations do not show, such as those of a calibration


class InnovationConsistency:
    """Time-average normalised innovation squared (NIS), which is 1 for a filter whose errors are as it states.

    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.2. It is below 1 for
    targets that fly more evenly, and sensors that err less, than their models say. Of two averages the larger one counts, so
    that it takes some measurements to trust the filter more, and a single large innovation to trust it as before.

    """

    def __init__(self) -> None:
        self._averages = {MEMORY: 1.0, SHORT_MEMORY: 1.0}
        self._nis = self._weight = 0.0

    @property
    def scale(self) -> float:
        """Ratio, LEAST to 1, of the variance of the errors to that of the filter."""
        return min(max(*self._averages.values(), LEAST), 1.0)

    def note(self, weight: float, innovation: float, variance: float) -> None:
        """Add the innovation of a component.

        Parameters:
            weight: weight of the component.
            innovation, variance: innovation of a scalar measurement and its variance, in any unit.
        """
        self._nis += weight * min(innovation * innovation / variance, LARGEST_NIS)
        self._weight += weight

    def adapt(self, fraction: float) -> None:
        """Average the innovations noted since the last call, with the effective sample fraction `fraction`."""
        if self._weight > 0.0:
            for memory, average in self._averages.items():
                gain = min(self._weight, 1.0) * (1.0 - math.exp(-fraction / memory))
                self._averages[memory] = average + gain * (self._nis / self._weight - average)
        self._nis = self._weight = 0.0


class SensorConsistency:
    """The consistency of the innovations of either sensor; that of sound counts anew from each detection on."""

    def __init__(self) -> None:
        self.sight, self.sound = InnovationConsistency(), InnovationConsistency()

    def adapt_to_sight(self, fraction: float) -> None:
        """See `InnovationConsistency.adapt`."""
        self.sight.adapt(fraction)
        self.sound = InnovationConsistency()

    def scale(self, seen: bool) -> float:
        """Ratio of the variance of the errors to that of the filter; `seen` where sight leads."""
        return (self.sight if seen else self.sound).scale
