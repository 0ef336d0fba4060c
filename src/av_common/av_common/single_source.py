"""Whether the messages of an input come from one source."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

CONTESTED_S = 0.25  # since the newest stamp that went back
JITTER_S = 0.01  # by which stamps of one source may go back, where its clock is corrected
KEPT, LEAST_KEPT = 100, 10  # delays of a source that are kept, and that make it known
EARLY_S, LATE_S = 0.01, 0.3  # by which a message may come before and after the usual delays: queues fill under attack


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
        self._stamp = self._measured = self._arrival = self._contested = -math.inf
        self._delays: deque[float] = deque(maxlen=KEPT)

    def take(self, stamp: float, arrival: float, measured: float = math.nan) -> bool:
        """Note a message; returns whether it can be used.

        Parameters:
            stamp (s): its capture time.
            arrival (s): time of its arrival.
            measured (s): capture time of the newest measurement that a bearing rests on, which does not go back either.
        """
        back = stamp < self._stamp - JITTER_S or measured < self._measured - JITTER_S
        if back and arrival >= self._arrival:  # an earlier arrival is a restart of the clock
            self._contested = arrival
        self._stamp, self._arrival = stamp, arrival
        self._measured = self._measured if math.isnan(measured) else measured
        contested = self.is_contested(arrival)
        self.refused += contested
        if not contested:
            self._delays.append(arrival - stamp)
        return not contested

    def is_punctual(self, stamp: float, arrival: float) -> bool:
        """Whether a message took as long as those of the source that was alone before.

        Parameters:
            stamp (s): its capture time.
            arrival (s): time of its arrival.
        """
        delays, tail = sorted(self._delays), len(self._delays) // 20
        return (len(delays) >= LEAST_KEPT
                and delays[tail] - EARLY_S <= arrival - stamp <= delays[-1 - tail] + LATE_S)

    def prolong(self, arrival: float) -> None:
        """Note a message that is impossible by itself, at `arrival` (s): a second source that was noticed goes on to send."""
        if self.is_contested(arrival):
            self._contested = arrival

    def is_contested(self, now: float) -> bool:
        """Whether two sources sent at `now` (s)."""
        return 0.0 <= now - self._contested < CONTESTED_S


class SingleSources:
    """A `SingleSource` for each topic.

    Parameters:
        topics: their names.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._sources = {topic: SingleSource() for topic in topics}

    @property
    def refused(self) -> dict[str, int]:
        """Number of messages that were not used, by topic."""
        return {topic: source.refused for topic, source in self._sources.items()}

    def take(self, topic: str, stamp: float, arrival: float, measured: float = math.nan) -> bool:
        """See `SingleSource.take`."""
        return self._sources[topic].take(stamp, arrival, measured)

    def is_punctual(self, topic: str, stamp: float, arrival: float) -> bool:
        """See `SingleSource.is_punctual`."""
        return self._sources[topic].is_punctual(stamp, arrival)

    def prolong(self, topic: str, arrival: float) -> None:
        """See `SingleSource.prolong`."""
        self._sources[topic].prolong(arrival)

    def is_contested(self, topic: str, now: float) -> bool:
        """Whether two sources of a topic sent at `now` (s)."""
        return self._sources[topic].is_contested(now)
