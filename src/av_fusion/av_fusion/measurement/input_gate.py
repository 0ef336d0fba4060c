"""Which messages of the inputs can be used, by their stamps and publishers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from av_common.freshness import SeenStamps, is_of_clock


class InputGate:
    """Refuses messages of another clock, those that come again, and those of an input that has a second publisher.

    Attributes:
        foreign_stamps: number of messages that were refused because of their stamps, by input.
        contested: publishers of the inputs that have more than one, by input: none of their messages is used, since which one
            is genuine cannot be seen from what it says.

    Parameters:
        names: of the inputs.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._arrivals = dict.fromkeys(names, -math.inf)
        self._seen = {name: SeenStamps() for name in self._arrivals}
        self.foreign_stamps = dict.fromkeys(self._arrivals, 0)
        self.contested: Mapping[str, list[str]] = {}

    def accept(self, name: str, stamp: float, arrival: float) -> bool:
        """Whether a message can be used.

        Parameters:
            name: of the input.
            stamp (s): capture time.
            arrival (s): time of its arrival.
        """
        is_known = self._seen[name].note(stamp, arrival)
        # A stamp from the future would let the tracker refuse all measurements until then.
        if not is_of_clock(stamp, arrival):
            self.foreign_stamps[name] += 1
            return False
        if is_known or name in self.contested:  # the same capture again is no new information
            return False
        self._arrivals[name] = arrival
        return True

    def restart(self) -> None:
        """Forget when inputs arrived, as the clock has stepped back; what arrived is no new information when it comes again."""
        self._arrivals = dict.fromkeys(self._arrivals, -math.inf)

    def silent(self, now: float, after: float) -> list[str]:
        """Inputs of which nothing arrived that could be used for `after` (s) at `now` (s)."""
        return [name for name, arrival in self._arrivals.items() if now - arrival > after]
