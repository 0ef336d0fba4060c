"""Values over recent time, such as attitudes, between which others interpolate."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from operator import itemgetter
from typing import Generic, TypeVar

Value = TypeVar('Value')
_TIME = itemgetter(0)


class Timeline(Generic[Value]):
    """Values in order of time; one thread may add while others read.

    Attributes:
        entries (n,): times (s), which do not decrease, and values.

    Parameters:
        keep (s): age relative to the newest up to which values are kept.
    """

    def __init__(self, keep: float) -> None:
        self._keep = keep
        self.entries: list[tuple[float, Value]] = []

    def add(self, time: float, value: Value) -> None:
        """Add a value at a time (s) that is not before the newest."""
        self.entries.append((time, value))
        if self.entries[0][0] < time - 2.0 * self._keep:  # trimmed rarely: cheap, and bounded
            self.entries = self.entries[bisect_left(self.entries, time - self._keep, key=_TIME):]

    def clear(self) -> None:
        """Forget all values."""
        self.entries = []

    def change(self, change: Callable[[Value], Value]) -> None:
        """Replace each value by what a function makes of it."""
        self.entries = [(time, change(value)) for time, value in self.entries]

    @property
    def newest(self) -> float:
        """Time (s) of the newest value; -inf without one."""
        return self.entries[-1][0] if self.entries else -math.inf

    @property
    def oldest(self) -> float:
        """Time (s) of the oldest value; inf without one."""
        return self.entries[0][0] if self.entries else math.inf

    def around(self, time: float) -> tuple[Value, Value, float]:
        """The values before and after a time (s), and its place between them (0 to 1); beyond both ends, that end twice.

        Raises IndexError without any value.
        """
        entries = self.entries
        after = bisect_right(entries, time, key=_TIME)
        if after in (0, len(entries)):
            _, end = entries[0 if after == 0 else -1]
            return end, end, 0.0
        (begin, earlier), (end_time, later) = entries[after - 1:after + 1]
        return earlier, later, (time - begin) / (end_time - begin)
