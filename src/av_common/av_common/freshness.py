"""How long ago the newest data of an input arrived, whatever is sent meanwhile."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

FUTURE_S = 0.1  # a stamp further ahead than this proves that a clock is wrong
CLOCK_TOLERANCE_S = 2.0  # a stamp this long before the time of arrival belongs to another clock, too
DISTRUST_S = 1.1  # after such a stamp nothing counts as new for this long: what had been captured by then is 1 s old
REMEMBERED = 64  # stamps of each kind that never count again: a middleware or a network that sends a message twice does so soon


class Instant(NamedTuple):
    """A time on two clocks.

    Parameters:
        steady (s): monotonic clock, used for ages, since a step of the system clock must not make old data fresh.
        ros (s): the node's clock, used for stamps.
    """

    steady: float
    ros: float


def is_of_clock(stamp: float, arrival: float, oldest: float = CLOCK_TOLERANCE_S) -> bool:
    """Whether a stamp can be of the clock by which its message arrived.

    Parameters:
        stamp (s): capture time.
        arrival (s): time of its arrival.
        oldest (s): age to which stamps are taken.
    """
    return -oldest <= stamp - arrival <= FUTURE_S


class CaptureClock:
    """Capture times by the steady clock, of stamps of a node's clock that may be set, or be simulated and slow.

    A stamp was captured when the node's clock first showed it within DISTRUST_S: what was captured before it was set back is
    never taken for newer than it is, however often that happens.
    """

    def __init__(self) -> None:
        self._shown: deque[Instant] = deque()

    def note(self, now: Instant) -> None:
        """Note both clocks."""
        self._shown.append(now)
        while self._shown[0].steady < now.steady - DISTRUST_S:
            self._shown.popleft()

    def captured(self, stamp: float, now: Instant) -> float:
        """When (s, steady) a message with a stamp (s) that arrives `now` was captured, at the latest."""
        self.note(now)
        before = None
        for at in self._shown:
            if at.ros >= stamp:
                break
            before = at
        else:
            return now.steady
        evenly = at.steady - (at.ros - stamp)    # of a clock that was set ahead since, too
        if before is None:
            return evenly
        share = (stamp - before.ros) / (at.ros - before.ros)
        return min(evenly, before.steady + share * (at.steady - before.steady))


class SeenStamps:
    """The last REMEMBERED stamps of an input that arrived, and apart from them the last that were from the future then.

    Others would displace those of the future before their time comes. A step of the node's clock makes none of them new.
    """

    def __init__(self) -> None:
        self._recent: deque[float] = deque(maxlen=REMEMBERED)
        self._future: deque[float] = deque(maxlen=REMEMBERED)

    def note(self, stamp: float, now: float) -> bool:
        """Whether a stamp arrived before; it is remembered.

        Parameters:
            stamp (s): capture time, on the node's clock.
            now (s): its arrival, on the same clock.
        """
        if stamp in self._recent or stamp in self._future:
            return True
        (self._recent if stamp <= now + FUTURE_S else self._future).append(stamp)
        return False


class FreshInput:
    """Notes when the stamps of an input advance.

    Only a stamp later than all before counts as new data, captured after all before by the steady clock, too: repeated,
    republished and reordered messages do not, nor what was captured before the node's clock stepped forth. Ages grow with the
    steady clock from the arrival on, so that no step of the node's clock renews them. After a stamp from the future, or a
    step of the node's clock back, the stamps of the next DISTRUST_S seconds are only compared with, and do not count. None
    of the SeenStamps, used or not, counts when its time comes again.

    Attributes:
        refused: number of stamps from the future, and of steps of the node's clock back.

    Parameters:
        latency (s): delay from capture to arrival that adds nothing to the age.
        clock: gives capture times; by default one that knows the times of arrival.
    """

    def __init__(self, latency: float = 0.0, clock: CaptureClock | None = None) -> None:
        self.refused = 0
        self._clock = clock or CaptureClock()
        self._latency = latency
        self._seen = SeenStamps()
        self._newest = self._captured = self._fresh = self._distrusted = -math.inf

    def take(self, stamp: float, now: Instant) -> bool:
        """Note a message; returns whether it carries new data.

        Parameters:
            stamp (s): capture time of its newest data, on the node's clock.
            now: its arrival.
        """
        is_known = self._seen.note(stamp, now.ros)
        if not max(stamp, self._newest) <= now.ros + FUTURE_S:
            self._newest, self._distrusted = -math.inf, now.steady
            self.refused += 1
            return False
        if is_known or stamp <= self._newest:
            return False
        self._newest = stamp
        if now.steady - self._distrusted < DISTRUST_S:
            return False
        captured = self._clock.captured(stamp, now)
        if captured <= self._captured:
            return False
        self._captured, self._fresh = captured, min(captured + self._latency, now.steady)
        return True

    def skip(self, stamp: float, now: Instant) -> None:
        """Note a message that is not used: neither it nor what was captured before it counts as new data later.

        Parameters:
            stamp (s): capture time of its newest data, on the node's clock.
            now: its arrival.
        """
        self._seen.note(stamp, now.ros)
        if stamp <= now.ros + FUTURE_S:
            self._newest = max(self._newest, stamp)

    def age(self, now: Instant) -> float:
        """Time (s) since the newest data arrived, or since it was captured if that is longer by more than `latency`.

        inf before the first.
        """
        return now.steady - self._fresh

    def captured_age(self, now: Instant) -> float:
        """Time (s) since the newest data was captured; inf before the first."""
        return now.steady - self._captured
