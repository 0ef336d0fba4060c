"""Rate of events and time since the last one."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

MISSING_AFTER_S = 1.0  # without messages, from which an input is reported as missing
WINDOW_S = 5.0  # over which the rate is computed


class RateMeter:
    """Counts events, measures their rate over a window and the time since the newest.

    Times are those of arrival on the monotonic clock, so that a wrong or replayed stamp cannot make old data look new.

    Attributes:
        count: number of all events.

    Parameters:
        now: function that returns the time in s.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.count = 0
        self._now = now
        self._arrivals: deque[float] = deque()

    def tick(self) -> None:
        """Count an event that happens now."""
        self.count += 1
        self._arrivals.append(self._now())
        while self._arrivals[0] < self._arrivals[-1] - WINDOW_S:
            self._arrivals.popleft()

    @property
    def rate(self) -> float:
        """Events per second over the window; 0 before the second event, and after a window without any."""
        arrivals = list(self._arrivals)  # one thread may tick while another asks
        if len(arrivals) < 2 or self._now() - arrivals[-1] > WINDOW_S:
            return 0.0
        return (len(arrivals) - 1) / max(arrivals[-1] - arrivals[0], 1e-9)

    @property
    def age(self) -> float:
        """Seconds since the newest event; inf before the first."""
        return self._now() - self._arrivals[-1] if self._arrivals else math.inf
