"""Whether the messages of an input come from one source."""

from __future__ import annotations

import math

CONTESTED_S = 0.25  # since the newest stamp that went back
JITTER_S = 0.01  # by which stamps of one source may go back, where its clock is corrected


class SingleSource:
    """Recognises a second source of an input by the order of stamps.

    One source captures, and the middleware delivers, in order of time. Where stamps go back, the messages of two sources
    alternate. Which of them is genuine cannot be told by what they say, since a forged message is as plausible as its sender
    wants it to be. Neither is used until one of them ends.

    Attributes:
        refused: number of messages that were not used.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._stamp = self._arrival = self._contested = -math.inf

    def take(self, stamp: float, arrival: float) -> bool:
        """Note a message; returns whether it can be used.

        Parameters:
            stamp (s): its capture time.
            arrival (s): time of its arrival.
        """
        if stamp < self._stamp - JITTER_S and arrival >= self._arrival:  # an earlier arrival is a restart of the clock
            self._contested = arrival
        self._stamp, self._arrival = stamp, arrival
        contested = self.is_contested(arrival)
        self.refused += contested
        return not contested

    def is_contested(self, now: float) -> bool:
        """Whether two sources sent at `now` (s)."""
        return 0.0 <= now - self._contested < CONTESTED_S
