"""The common clock of a simulator's streams, so that the stamps of one moment agree in all of them."""

from __future__ import annotations

import math
import threading
from collections.abc import Hashable
from typing import NamedTuple

from av_common.clock import CHASE, LATEST_S, ElapsedTime, Order, SenderClock
from av_common.stamps import END_S

SILENCE_S = 1.0          # after this time without a dated stamp another sender may take a stream over
TOGETHER_S = 0.02        # offsets of streams that support each other
DELAY_S = 0.25           # a stream may precede the common offset by this much, if that rests on a slower stream
BEGIN_S = 2.0            # after the common offset is set: the lowest of offsets with equal support wins
STEP_S = 0.05            # interval between comparisons


class _Stream:
    """A stream and its sender, which keeps it until none of its stamps was dated for SILENCE_S."""

    def __init__(self) -> None:
        self.refused = self.restarts = 0
        self.begin(None)

    def begin(self, sender: Hashable) -> None:
        """Take the stamps of another sender."""
        self.sender, self.clock, self.order = sender, SenderClock(), Order()
        self.accepted = self.dated = -math.inf    # s, elapsed time of the newest stamp that the clock took, and that was dated
        self.followed = 0, 0    # restarts of the common offset and of the clock

    def is_taken(self, now: float) -> bool:
        """Whether others are refused."""
        return self.dated >= now - SILENCE_S


class StreamCounts(NamedTuple):
    """What a stream's stamps came to.

    Parameters:
        refused: number of stamps that could not be dated.
        restarts: number of times that a sender's clock restarted.
    """

    refused: int
    restarts: int


class CommonClock:
    """One clock for the streams of a simulator, whose stamps are of one clock and whose delays differ.

    Each stream has one sender at a time, and a SenderClock of it. The common offset is the one that most kinds of streams
    share, so that no single stream can move it. Streams may be later than the common offset, such as images; stamps of a stream
    that contradicts it are refused. No stamp is dated later than its arrival. May be called from any thread.

    Attributes:
        restarts: number of times that the common offset was replaced.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._time, self._lock = ElapsedTime(), threading.Lock()
        self._streams: dict[str, _Stream] = {}
        self._offset = math.nan
        self._compared = self._begin = -math.inf
        self._settled = False    # whether stamps that have agreed have set the offset

    @property
    def counts(self) -> dict[str, StreamCounts]:
        """Counts of each stream by its name."""
        with self._lock:
            return {name: StreamCounts(stream.refused, stream.restarts) for name, stream in self._streams.items()}

    def sender(self, stream: str) -> Hashable:
        """The sender whose stamps of a stream are dated, None while there is none."""
        with self._lock:
            taken = self._streams.get(stream)
            return taken.sender if taken and taken.is_taken(self._time.now) else None

    @property
    def lateness(self) -> float:
        """Delay (s) of the quickest stream of the last second relative to its least delay: that of a sender too slow."""
        with self._lock:
            now = self._time.now
            return min((stream.clock.lateness for stream in self._streams.values() if stream.is_taken(now)), default=0.0)

    def date(self, stream: str, sender: Hashable, stamp: float, arrival: float) -> float | None:
        """ROS time (s) of a stamp, None when it cannot be dated; it lies in the range of builtin_interfaces/Time.

        Parameters:
            stream: name of the stream. Names with the same first word are one kind, with one vote on the common offset.
            sender: address of the sender.
            stamp (s): time on the sender's clock.
            arrival (s): ROS time of its arrival.
        """
        if not 0.0 <= arrival < END_S:
            return None
        with self._lock:
            now = self._time.at(arrival)
            taken = self._streams.setdefault(stream, _Stream())
            time = self._date(taken, sender, stamp, arrival, now)
            taken.refused += time is None
            return time

    def _date(self, stream: _Stream, sender: Hashable, stamp: float, arrival: float, now: float) -> float | None:
        if sender != stream.sender:
            if stream.is_taken(now):
                return None
            stream.begin(sender)
        before = stream.clock.restarts
        time = stream.clock.date(stamp, arrival)
        stream.restarts += stream.clock.restarts - before
        if time is None:
            return None
        stream.accepted = now
        self._compare(now)
        if not -DELAY_S <= stream.clock.offset - self._offset <= LATEST_S:
            return None
        restarts = self.restarts, stream.clock.restarts
        if restarts != stream.followed:
            stream.order = Order()
        stream.dated, stream.followed = now, restarts
        least = 1.0 - CHASE if stream.clock.settled else 0.0
        return max(stream.order.kept(stamp, min(time, stamp + self._offset), arrival, least), 0.0)

    def _compare(self, now: float) -> None:
        """Move the common offset towards the offset that most kinds of streams share, or replace it."""
        elapsed = now - self._compared
        if elapsed < STEP_S and not math.isnan(self._offset):
            return
        self._compared = now
        clocks = [(name.partition(' ')[0], stream.clock) for name, stream in self._streams.items()
                  if stream.accepted >= now - SILENCE_S]
        settled = [(kind, clock) for kind, clock in clocks if clock.settled]
        if not settled and self._settled:
            return    # stamps that have not agreed set the offset provisionally, and never move it
        self._settled = self._settled or bool(settled)
        votes: dict[str, list[float]] = {}
        for kind, clock in settled or clocks:
            votes.setdefault(kind, []).append(clock.offset)
        target = _shared(votes, self._offset, now - self._begin < BEGIN_S)
        change = target - self._offset
        if abs(change) <= TOGETHER_S:
            most = elapsed * CHASE
            self._offset += max(-most, min(most, change))
            return
        if not abs(change) <= DELAY_S:
            self.restarts += not math.isnan(change)
            self._begin = now
        self._offset = target


def _shared(votes: dict[str, list[float]], present: float, beginning: bool) -> float:
    """The offset (s) that most kinds of streams share.

    Parameters:
        votes (s): offsets of each kind of stream; at least one.
        present (s): the present common offset, which wins a tie; NaN without one.
        beginning: whether the lowest wins a tie, because the least delay is still unknown.
    """
    def supporters(offset: float) -> list[float]:
        near = ([other for other in offsets if abs(other - offset) <= TOGETHER_S] for offsets in votes.values())
        return sorted(min(offsets) for offsets in near if offsets)

    support = {offset: supporters(offset) for offsets in votes.values() for offset in offsets}
    most = max(len(group) for group in support.values())
    best = [offset for offset, group in support.items() if len(group) == most]
    lower = DELAY_S if beginning else TOGETHER_S
    group = support[min([offset for offset in best if -lower <= offset - present <= TOGETHER_S] or best)]
    return group[(len(group) - 1) // 2]
