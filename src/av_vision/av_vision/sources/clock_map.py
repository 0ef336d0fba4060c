"""A device's clock on the caller's time axis."""

from __future__ import annotations

import math


class ClockMap:
    """Maps stamps of a device's free-running clock to the caller's clock.

    A frame arrives later than it was taken by a delay that is never less than the cable's; the least difference between
    arrival and stamp is therefore the best guess of the offset (Cristian 1989). It is let grow by `drift`, so that a device's
    clock that runs slow or fast is followed.
    """

    def __init__(self, drift: float = 1e-4, jump_s: float = 1.0) -> None:
        self._drift = drift
        self._jump_s = jump_s
        self._offset = math.inf
        self._stamp = -math.inf

    def map(self, stamp: float, arrival: float) -> float:
        """The caller's time of a stamp, both in s, not after the arrival. A stamp that jumps begins anew."""
        if stamp < self._stamp or abs(arrival - stamp - self._offset) > self._jump_s:
            self._offset = arrival - stamp
        else:
            self._offset = min(self._offset + self._drift * (stamp - self._stamp), arrival - stamp)
        self._stamp = stamp
        return stamp + self._offset
