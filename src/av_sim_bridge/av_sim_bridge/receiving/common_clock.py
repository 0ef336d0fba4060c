"""The common clock of a simulator's streams, so that the stamps of one moment agree in all of them."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict

from av_common.clock import CHASE, LATEST_S, ElapsedTime, Order, SenderClock
from av_common.stamps import END_S
from av_sim_bridge.receiving.allowed_senders import Sender
from av_sim_bridge.wire import ForeignSenderError, UndatedError

SILENCE_S = 1.0          # after this time without a usable datagram another sender may take a stream over
DELAY_S = 0.25           # a stream may precede the common offset by this much, if that rests on a slower stream
STEP_S = 0.05            # interval between comparisons
SAME_CAPTURE_S = 0.05    # largest difference of the dates of one capture in two streams
SET_BACK_S = 2.0         # dates earlier by more are of a clock that was set back: an old state is dated within LATEST_S
MOST_CAPTURES = 32       # whose dates are remembered: a second of two cameras


class OneSender:
    """The sender of a stream, address and port, of which there is one at a time.

    Parameters:
        name: name of the stream.
    """

    def __init__(self, name: str) -> None:
        self._name, self._time = name, ElapsedTime()
        self._present: tuple[Sender, float] | None = None    # sender, and elapsed time of its newest datagram (s)

    def check(self, sender: Sender, arrival: float) -> bool:
        """Whether a sender is another one than before. Raises ForeignSenderError while the present one sends."""
        if self._present is None or self._present[0] == sender:
            return False
        if self._time.at(arrival) - self._present[1] < SILENCE_S:
            raise ForeignSenderError(self._name, sender, self._present[0])
        return True

    def note(self, sender: Sender, arrival: float) -> None:
        """Note a usable datagram."""
        self._present = sender, self._time.at(arrival)


class _Stream:
    """A stream, and the clock of the sender of its newest stamp."""

    def __init__(self, name: str) -> None:
        self.refused = self.restarts = 0
        self.one_sender = OneSender(name)
        self.newest = -math.inf, -math.inf    # stamp and date of the newest state
        self.begin(())

    def begin(self, sender: Sender) -> None:
        """Take the stamps of another sender."""
        self.sender, self.clock, self.order = sender, SenderClock(), Order()
        self.accepted = -math.inf    # s, elapsed time of the newest stamp that the clock took
        self.followed = 0    # restarts of the common offset and of the clock


class CommonClock:
    """One clock for the streams of a simulator, whose stamps are of one clock and whose delays differ.

    Each stream has one sender at a time, and a SenderClock of it. The common offset is the median of those of all kinds of
    streams, so that no single one of three or more can move it. Streams may be later than the common offset, such as images;
    stamps of a stream that contradicts it are refused. No stamp is dated later than its arrival. May be called from any thread.

    Attributes:
        restarts: number of times that the common offset was replaced.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._time, self._lock = ElapsedTime(), threading.Lock()
        self._streams: dict[str, _Stream] = {}
        self._captures: OrderedDict[float, float] = OrderedDict()    # dates of captures, by their stamps
        self._offset = math.nan
        self._compared = -math.inf
        self._settled = False    # whether stamps that have agreed have set the offset

    @property
    def counts(self) -> dict[str, int]:
        """Of each stream the numbers of stamps that could not be dated, and of restarts of its sender's clock."""
        with self._lock:
            return {f'{name} {what}': count for name, stream in self._streams.items()
                    for what, count in (('undated', stream.refused), ('clock restarts', stream.restarts))}

    def refuse_others(self, stream: str, sender: Sender, arrival: float) -> None:
        """Raise ForeignSenderError for another sender (host, port) than that whose stamps of a stream are dated."""
        with self._lock:
            if stream in self._streams:
                self._streams[stream].one_sender.check(sender, arrival)

    def date(self, stream: str, sender: Sender, stamp: float, arrival: float) -> float:
        """ROS time (s) of a stamp; it lies in the range of builtin_interfaces/Time.

        Raises UndatedError for a stamp that cannot be dated, ForeignSenderError for that of another than the present sender.

        Parameters:
            stream: name of the stream. Names with the same first word are one kind, with one vote on the common offset.
            sender: address of the sender.
            stamp (s): time on the sender's clock.
            arrival (s): ROS time of its arrival.
        """
        with self._lock:
            taken = self._streams.setdefault(stream, _Stream(stream))
            taken.refused += 1    # until it is dated
            time = self._date(taken, sender, stamp, arrival)
            if time is None:
                raise UndatedError(f'{stream}: the time {stamp:g} s of {sender[0]}:{sender[1]} cannot be dated')
            taken.refused -= 1
            return time

    def date_state(self, stream: str, sender: Sender, stamp: float, arrival: float) -> float | None:
        """The same of a state, such as a pose, later than those before; None for one that comes again or out of order."""
        date = self.date(stream, sender, stamp, arrival)
        state = self._streams[stream]    # which one thread alone dates
        newest, newest_date = state.newest
        if (date <= newest_date or stamp == newest) and date > newest_date - SET_BACK_S:
            return None
        state.newest = stamp, date
        return date

    def date_capture(self, stream: str, sender: Sender, stamp: float, arrival: float) -> float:
        """The same of a part of a capture: that of its first part in any stream, so that all of one capture have one date."""
        date = self.date(stream, sender, stamp, arrival)
        with self._lock:
            if abs(self._captures.get(stamp, date) - date) > SAME_CAPTURE_S:    # the sender has restarted
                del self._captures[stamp]
            first = self._captures.setdefault(stamp, date)
            if len(self._captures) > MOST_CAPTURES:
                self._captures.popitem(last=False)
            return first

    def _date(self, stream: _Stream, sender: Sender, stamp: float, arrival: float) -> float | None:
        if not 0.0 <= arrival < END_S:
            return None
        now = self._time.at(arrival)
        stream.one_sender.check(sender, arrival)
        if sender != stream.sender:
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
        stream.one_sender.note(sender, arrival)
        restarts = self.restarts + stream.restarts
        if restarts != stream.followed:
            stream.order, stream.followed = Order(), restarts
        least = 1.0 - CHASE if stream.clock.settled else 0.0
        return max(stream.order.kept(stamp, min(time, stamp + self._offset), arrival, least), 0.0)

    def _compare(self, now: float) -> None:
        """Move the common offset towards the median of those of all kinds of streams, or replace it."""
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
        votes: dict[str, float] = {}
        for kind, clock in settled or clocks:
            votes[kind] = min(votes.get(kind, math.inf), clock.offset)
        offsets = sorted(votes.values())
        target = offsets[(len(offsets) - 1) // 2]
        if target < self._offset - DELAY_S:
            target = offsets[len(offsets) // 2]    # a tie is no reason to jump
        change = target - self._offset
        if abs(change) <= DELAY_S:
            self._offset += max(-elapsed * CHASE, min(elapsed * CHASE, change))
        else:
            self.restarts += not math.isnan(change)
            self._offset = target
