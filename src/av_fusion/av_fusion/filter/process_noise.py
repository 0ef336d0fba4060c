"""How sharply the target turns just now, judged by how much it surprises."""

from __future__ import annotations

import math

USUAL_SURPRISE, MOST_SURPRISE = 1.0, 9.0
ALERT, CALM = 3.0, 1.0  # how fast it rises, and falls
LEAST, MOST = 0.03, 10.0
LEAST_SEEN = 0.1  # eyes follow without the faith that ears need
EVEN = 7.0  # so many independent measurements without a surprise halve what is usual
STARTLED = 2.0  # what goes beyond this is such a surprise
SLOW = math.radians(5.0)  # a second; who hardly moves has not shown how


class Agility:
    """Acceleration in times the usual one: it rises after surprises, falls without.

    Surprise is innovation squared over its variance (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking
    and Navigation, 2001, section 11.2.2), over all modes by their weight. It belongs to the target: were it each mode's own,
    a false image that is often surprised could soon follow anything, and would outlive the true one. Below the usual it
    falls as evenness lasts: who flew evenly for seconds will rarely turn back just where nothing would tell, at end-fire.
    """

    def __init__(self) -> None:
        self.value = 1.0
        self._even = self._surprise = self._weight = self._moving = 0.0

    def note(self, weight: float, rate: float, innovation: float, variance: float) -> None:
        """A mode of this weight, and rate in rad/s, met a measurement."""
        self._surprise += weight * min(innovation * innovation / variance, MOST_SURPRISE)
        self._weight += weight
        self._moving += weight * rate * rate / (rate * rate + SLOW**2)

    def adapt(self, fresh: float) -> None:
        """Take account of what was noted; `fresh` is the share of the measurement that is new evidence."""
        more = self._surprise - USUAL_SURPRISE * self._weight
        value = self.value * math.exp((ALERT if more > 0.0 else CALM) * fresh * more)
        self._even = 0.0 if value > STARTLED else self._even + fresh * self._moving
        self.value = min(max(value, LEAST, 1.0 / (1.0 + (self._even / EVEN) ** 2)), MOST)
        self._surprise = self._weight = self._moving = 0.0
