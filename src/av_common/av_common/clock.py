"""The clock of a sender: converts its stamps to ROS time by their times of arrival.

An arrival can be late but never early, so the least delay gives the offset between two clocks (Cristian 1989). Stamps come
from outside and may be anything: only agreement over time sets or moves the offset, never a single stamp.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque

from av_common.stamps import END_S

AGREEMENT_S = 1.0        # stamps must agree for this long before they set the clock; later they determine it for as long
AGREEMENT_ERROR_S = 0.015    # of offsets before and after the middle of that time, and of stamps older than others before
FEWEST = 4               # stamps that can agree
MAJORITY = 3             # ratio to the stamps that agree with the present offset, for a restart
SPACING_S = 0.005        # arrivals closer than this count once, so that a flood has no more weight than a stream
STEP_S = 0.1             # interval between corrections
DRIFT = 1e-3             # slew (s/s) in normal operation: twice the largest drift of 500 ppm
UNSEEN_DRIFT = 1e-4      # slew (s/s), either way, while the sender is late: twice that of crystals
CHASE = 0.5              # slew (s/s) after a deviation of more than EARLY_S for a whole second
EARLY_S = 0.01           # error of the offset itself: a stamp may precede it by this much, and more is chased
LATEST_S = 1.0           # largest delay of a stamp, relative to the least one
WIDTH_S = 0.1            # largest difference of the offsets of one candidate from its first
MOST_CANDIDATES = 16     # so that a flood costs little
LARGEST_STAMP_S = 1e11   # s; float64 resolves it to 15 us


class ElapsedTime:
    """Time that has passed according to arrivals; it never runs backwards, and a step back of their clock is no time."""

    def __init__(self) -> None:
        self.now, self._arrival = 0.0, math.nan

    def at(self, arrival: float) -> float:
        """Time (s) since the first arrival (s), also kept in `now`."""
        step = arrival - self._arrival
        if step > 0.0:
            self.now += step
        if not -1.0 < step <= 0.0:    # slightly out of order: the arrivals of several threads
            self._arrival = arrival
        return self.now


class Order:
    """Keeps dates in the order of their stamps, whatever an offset does: a later stamp is never dated earlier."""

    def __init__(self) -> None:
        self._stamp = self._date = -math.inf    # newest stamp, and its date

    def kept(self, stamp: float, date: float, arrival: float, least: float) -> float:
        """The date (s) nearest to `date` that keeps the order; it is not later than the arrival, which has the last word.

        Parameters:
            stamp, date, arrival (s): see `SenderClock.date`.
            least (s/s): dates advance by at least this share of the time between stamps, so that rates hardly differ.
        """
        if stamp < self._stamp:
            return min(date, self._date)
        if self._stamp > -math.inf:
            date = max(date, self._date + least * (stamp - self._stamp))
        self._stamp, self._date = stamp, min(date, arrival)
        return self._date


class _Offset:
    """Arrivals whose stamps share one offset: the hypothesis of a clock.

    Parameters:
        now (s): elapsed time of the first arrival.
        offset (s): arrival minus stamp.
    """

    def __init__(self, now: float, offset: float) -> None:
        self.begin = self.end = now
        self.first = offset
        self._samples = deque([(now, offset)])

    def add(self, now: float, offset: float) -> None:
        self.end = now
        if now - self._samples[-1][0] >= SPACING_S:
            self._samples.append((now, offset))
        while len(self._samples) > FEWEST and self._samples[0][0] < now - AGREEMENT_S:
            self._samples.popleft()

    def fits(self, offset: float) -> bool:
        return abs(offset - self.first) <= WIDTH_S

    def count(self, now: float, window: float = AGREEMENT_S) -> int:
        """Number of arrivals in the window (s) that ends `now` (s)."""
        return sum(time >= now - window for time, _ in self._samples)

    def settle(self) -> float:
        """The offset: the lowest of the densest arrivals, as delays crowd at the least one. Earlier ones are dropped."""
        offsets = sorted(offset for _, offset in self._samples)
        lowest = max(offsets, key=lambda low: bisect_right(offsets, low + AGREEMENT_ERROR_S) - bisect_left(offsets, low))
        self._samples = deque((time, offset) for time, offset in self._samples if offset >= lowest - EARLY_S)
        return lowest

    def low(self, begin: float = -math.inf, end: float = math.inf) -> float:
        """The lowest tenth of the offsets from `begin` to before `end` (s) is below this; NaN without any."""
        offsets = sorted(offset for time, offset in self._samples if begin <= time < end)
        return offsets[len(offsets) // 10] if offsets else math.nan

    @property
    def span(self) -> float:
        """Time (s) from the oldest to the newest arrival in memory."""
        return self._samples[-1][0] - self._samples[0][0]

    @property
    def is_whole(self) -> bool:
        """Whether the arrivals are enough to agree, and last for AGREEMENT_S."""
        return self.end - self.begin >= AGREEMENT_S and len(self._samples) >= FEWEST

    @property
    def agrees(self) -> bool:
        """Whether the arrivals show one constant offset over AGREEMENT_S."""
        if not self.is_whole:
            return False
        middle = self._samples[-1][0] - self.span / 2.0
        return abs(self.low(end=middle) - self.low(begin=middle)) <= AGREEMENT_ERROR_S

    @property
    def grows(self) -> bool:
        """Whether the offset grows evenly over AGREEMENT_S, by what can be followed: a simulation slower than time."""
        if not self.is_whole:
            return False
        begin, third = self._samples[0][0], self.span / 3.0
        first, second, last = (self.low(begin + k * third, begin + (k + 1.001) * third) for k in range(3))
        return 0.0 < last - first <= 2.0 * third * CHASE and abs(first - 2.0 * second + last) <= AGREEMENT_ERROR_S


class SenderClock:
    """The offset between ROS time and the clock of one stream of one sender.

    A stamp is dated when it is at most EARLY_S before and LATEST_S behind the offset. The offset follows the low arrivals
    of the last second with a bounded slew. Other stamps are refused, and form candidates for a new offset. A candidate
    takes over, as a restart, once its stamps have agreed for AGREEMENT_S, clearly outnumber those of the present offset, and
    are no fewer than those of any other candidate.
    A stamp that is both late and older than its predecessor is refused as well, since the sender's clock may have stepped
    back. No stamp is dated later than its arrival, and none before an older one, but where the offset was replaced.

    A sender that was late for a while is on time again by its least offset before. One that was late while its first stamps
    agreed seems to jump ahead then. Where nobody else can send at its address, `early` makes that no restart: the arrivals
    prove an offset that is less.

    Until the first stamps have agreed for AGREEMENT_S the offset is provisional: the least one of them, which may be
    LATEST_S less than the first. A first stamp that is wrong is thus replaced as soon as the others have agreed. The first
    stamps also agree where they show a constant rate, from half of real time on.

    Parameters:
        drift (s/s): slew of the offset in normal operation.
        early (s): by which a stamp may precede the offset; it is dated by its arrival, and the offset follows.

    Attributes:
        settled: whether stamps have agreed for AGREEMENT_S.
        refused: number of stamps that could not be dated.
        restarts: number of times that the offset was replaced.
    """

    def __init__(self, drift: float = DRIFT, early: float = EARLY_S) -> None:
        self.refused = self.restarts = 0
        self.settled = False
        self._drift, self._early = drift, early
        self._time, self._order = ElapsedTime(), Order()
        self._accepted: _Offset | None = None
        self._candidates: list[_Offset] = []
        self._offset = self._floor = math.nan
        self._earliest = math.nan    # the floor by which it was on time last
        self._newest = self._renewed = -math.inf    # newest stamp, and when it arrived first
        self._corrected = 0.0

    @property
    def offset(self) -> float:
        """ROS time minus the sender's time (s), NaN before it is known."""
        return self._offset

    def date(self, stamp: float, arrival: float) -> float | None:
        """ROS time (s) of a stamp, None when it cannot be dated; it lies in the range of builtin_interfaces/Time.

        Parameters:
            stamp (s): time on the sender's clock.
            arrival (s): ROS time of its arrival.
        """
        if not (abs(stamp) <= LARGEST_STAMP_S and 0.0 <= arrival < END_S):
            self.refused += 1
            return None
        now, offset = self._time.at(arrival), arrival - stamp
        if self._accepted is not None and self._fits(self._accepted, stamp, offset, now):
            self._follow(self._accepted, now, offset)
        elif not self._propose(now, offset):
            self.refused += 1
            return None
        if stamp > self._newest:
            self._newest, self._renewed = stamp, now
        # Before stamps have agreed, those of a first one that was late may all have its date.
        least = 1.0 - CHASE if self.settled else 0.0
        return max(self._order.kept(stamp, stamp + self._offset, arrival, least), 0.0)

    def _fits(self, accepted: _Offset, stamp: float, offset: float, now: float) -> bool:
        lag = offset - self._offset
        if lag < 0.0:
            return offset >= (self._earliest - self._early if self.settled else accepted.first - LATEST_S)
        if lag <= AGREEMENT_ERROR_S:
            return True
        repeated = stamp == self._newest and now > self._renewed + WIDTH_S    # a clock that stands still
        if lag > LATEST_S or stamp < self._newest or repeated:
            return False
        refused = sum(candidate.count(now, lag) for candidate in self._candidates if candidate.fits(offset))
        return refused < accepted.count(now, lag) or not refused

    def _follow(self, accepted: _Offset, now: float, offset: float) -> None:
        accepted.add(now, offset)
        if not self.settled:
            self._offset = self._floor = self._earliest = min(self._offset, offset)
            self.settled = accepted.agrees or accepted.grows
        elapsed = now - self._corrected
        if elapsed < STEP_S or not self.settled:
            return
        self._corrected = now
        error = accepted.low() - self._offset
        steady = accepted.count(now) > FEWEST and accepted.span > 0.8 * AGREEMENT_S
        most = elapsed * (CHASE if steady and abs(error) > EARLY_S else self._drift)
        self._offset += max(-most, min(most, error))
        on_time = abs(error) <= EARLY_S and self._offset - self._floor <= EARLY_S
        self._floor = min(self._floor + (self._drift if on_time else UNSEEN_DRIFT) * elapsed, self._offset)
        self._earliest = self._floor if on_time else min(self._earliest - UNSEEN_DRIFT * elapsed, self._offset)

    def _propose(self, now: float, offset: float) -> bool:
        """Add an arrival to the candidates; True when it completes an agreement, and is not before its offset."""
        candidate = self._candidate(now, offset)
        if self._accepted is not None:
            count = candidate.count(now)
            if not (candidate.agrees and count > MAJORITY * self._accepted.count(now)
                    and count == max(other.count(now) for other in self._candidates)):
                return False
            self.restarts += self.settled
            self.settled = True
        self._accepted, self._candidates, self._order = candidate, [], Order()
        self._offset = self._floor = self._earliest = candidate.settle()
        self._newest, self._corrected = -math.inf, now
        return offset >= self._offset - self._early

    def _candidate(self, now: float, offset: float) -> _Offset:
        """The candidate that an arrival joins or begins."""
        self._candidates = [other for other in self._candidates if other.end >= now - 2.0 * AGREEMENT_S]
        joined = next((candidate for candidate in self._candidates if candidate.fits(offset)), None)
        if joined is not None:
            joined.add(now, offset)
            return joined
        if len(self._candidates) >= MOST_CANDIDATES:
            self._candidates.remove(min(self._candidates, key=lambda other: other.count(now)))
        self._candidates.append(_Offset(now, offset))
        return self._candidates[-1]
