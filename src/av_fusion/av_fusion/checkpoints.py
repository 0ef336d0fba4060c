"""Recent states of a tracker, to return to from before measurements that should not have been used."""

from __future__ import annotations

import math
import pickle
from collections import deque

from av_fusion.tracker_protocol import Tracker

PERIOD_S = 0.25
LEAST_AGE_S, LARGEST_AGE_S = 0.15, 0.75  # of a state to return to: longer than two sources take to be noticed


class Checkpoints:
    """Keeps a copy of the tracker every PERIOD_S. Serialised, because that takes a twentieth of the time of a deep copy."""

    def __init__(self) -> None:
        self._kept: deque[tuple[float, bytes]] = deque(maxlen=math.ceil(LARGEST_AGE_S / PERIOD_S) + 1)

    def keep(self, tracker: Tracker, now: float) -> None:
        """Keep the state at `now` (s), if it is time to."""
        if not self._kept or not 0.0 <= now - self._kept[-1][0] < PERIOD_S:
            self._kept.append((now, pickle.dumps(tracker, pickle.HIGHEST_PROTOCOL)))

    def before(self, now: float) -> Tracker | None:
        """The newest state that is old enough at `now` (s); None without a recent one."""
        for time, state in reversed(self._kept):
            if LEAST_AGE_S <= now - time <= LARGEST_AGE_S:
                tracker: Tracker = pickle.loads(state)
                return tracker
        return None
