"""How sharply the target turns just now, judged by how much it surprises."""

from __future__ import annotations

import math

USUAL_SURPRISE, MOST_SURPRISE = 1.0, 9.0
ALERT, CALM = 3.0, 1.0  # how fast it rises, and falls
MOST = 10.0


class Agility:
    """Acceleration in times the usual one: it rises after surprises, falls without.

    Surprise is innovation squared over its variance (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking
    and Navigation, 2001, section 11.2.2), over all modes by their weight. It belongs to the target: were it each mode's own,
    a false image that is often surprised could soon follow anything, and would outlive the true one.
    """

    def __init__(self) -> None:
        self.value = 1.0
        self._surprise = self._weight = 0.0

    def note(self, weight: float, innovation: float, variance: float) -> None:
        """A mode of this weight met a measurement."""
        self._surprise += weight * min(innovation * innovation / variance, MOST_SURPRISE)
        self._weight += weight

    def adapt(self, fresh: float) -> None:
        """Take account of what was noted; `fresh` is the share of the measurement that is new evidence."""
        if self._weight > 0.0:
            more = self._surprise / self._weight - USUAL_SURPRISE
            self.value = min(max(self.value * math.exp((ALERT if more > 0.0 else CALM) * fresh * more), 1.0), MOST)
        self._surprise = self._weight = 0.0
