"""Which messages of the inputs can be used, by their stamps."""

from __future__ import annotations

import math
from collections.abc import Iterable

from av_common.freshness import FUTURE_S
from av_common.single_source import SingleSources


class InputGate:
    """Refuses messages of another clock, and those of an input with two sources.

    Attributes:
        sources: whether an input has two sources.
        foreign_stamps: number of messages that were refused because of their stamps, by input.

    Parameters:
        names: of the inputs.
        tolerance (s): a stamp this long before the time of arrival, or FUTURE_S later, belongs to another clock.
    """

    def __init__(self, names: Iterable[str], tolerance: float) -> None:
        self._arrivals = dict.fromkeys(names, -math.inf)
        self._tolerance = tolerance
        self.sources = SingleSources(self._arrivals)
        self.foreign_stamps = dict.fromkeys(self._arrivals, 0)
        self._newest = dict.fromkeys(self._arrivals, -math.inf)  # stamps of messages that were used
        self._trusted = dict(self._newest)  # of those while the input had one source

    def accept(self, name: str, stamp: float, arrival: float) -> bool:
        """Whether a message can be used.

        Parameters:
            name: of the input.
            stamp (s): capture time.
            arrival (s): time of its arrival.
        """
        # A stamp from the future would let the tracker refuse all measurements until then.
        own_clock = -self._tolerance <= stamp - arrival <= min(self._tolerance, FUTURE_S)
        accepted = own_clock and self.sources.take(name, stamp, arrival)
        if not own_clock:
            self.foreign_stamps[name] += 1
            self.sources.prolong(name, arrival)
        if accepted or not own_clock:
            self._arrivals[name] = arrival
        return accepted

    def continues(self, name: str, stamp: float, arrival: float) -> bool:
        """Whether a message of an input with two sources can be the next one of the source that was alone before, by its stamp.

        Parameters:
            name: of the input.
            stamp (s): capture time.
            arrival (s): time of its arrival.
        """
        return (self.sources.is_contested(name, arrival) and stamp > self._newest[name]
                and self.sources.is_punctual(name, stamp, arrival))

    def use(self, name: str, stamp: float, arrival: float) -> None:
        """Note a message that is used: its input, its capture time (s), and time of its arrival (s)."""
        self._newest[name] = stamp
        if not self.sources.is_contested(name, arrival):
            self._trusted[name] = stamp

    def trusted(self, name: str) -> float:
        """Newest stamp (s) of a message that was used while its input had one source."""
        return self._trusted[name]

    def is_doubtful(self, name: str, now: float) -> bool:
        """Whether the newest message of an input that was used may be another source's, at `now` (s)."""
        return self.sources.is_contested(name, now) or self._newest[name] > self._trusted[name]

    def silent(self, now: float, after: float) -> list[str]:
        """Inputs of which nothing arrived, or nothing that could be used, for `after` (s) at `now` (s)."""
        return [name for name, arrival in self._arrivals.items() if now - arrival > after]
