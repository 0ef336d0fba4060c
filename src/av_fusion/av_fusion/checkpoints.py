"""Recent states of what learns from measurements, to return to from before some that should not have been used."""

from __future__ import annotations

import math
import pickle
from collections import deque
from typing import Any

PERIOD_S = 0.25
LEAST_AGE_S, LARGEST_AGE_S = 0.15, 0.75  # of a state to return to: longer than two sources take to be noticed


class Checkpoints:
    """Keeps copies of objects that belong together every PERIOD_S, serialised: a deep copy takes twenty times as long."""

    def __init__(self) -> None:
        self._kept: deque[tuple[float, bytes]] = deque(maxlen=math.ceil(LARGEST_AGE_S / PERIOD_S) + 1)

    def keep(self, state: tuple[Any, ...], now: float) -> None:
        """Keep a copy of the objects at `now` (s), if it is time to."""
        if not self._kept or not 0.0 <= now - self._kept[-1][0] < PERIOD_S:
            self._kept.append((now, pickle.dumps(state, pickle.HIGHEST_PROTOCOL)))

    def before(self, now: float) -> tuple[Any, ...] | None:
        """The newest copies that are old enough at `now` (s); None without recent ones."""
        for time, state in reversed(self._kept):
            if LEAST_AGE_S <= now - time <= LARGEST_AGE_S:
                copies: tuple[Any, ...] = pickle.loads(state)
                return copies
        return None
