"""Records of a bag under the topic names of the rig, in its message types, with arrival times of one clock."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from av_bags import topics as names
from av_bags.converters import AudioLayout, converter
from av_bags.definitions import BagError
from av_bags.reader import Bag, Row
from av_bags.timeline import GAP_NS
from av_common.freshness import CLOCK_TOLERANCE_S, is_of_clock
from av_common.rig import CAMERAS, camera_topics

SECOND = 10**9  # ns
SHORTEST = 4  # bytes of a message, those of its encapsulation: the middleware reads beyond the end of shorter ones
MOST_WAITING = 100    # messages behind a stamp that may be wrong
MOST_REASONS = 20     # why messages of a topic cannot be read, that are told apart: many name the size of a message
# Topics with stamps of the rig's clock, by which another clock is recognised.
CLOCKED = (names.AUDIO, names.DOA, *camera_topics(CAMERAS, names.DETECTIONS), names.ODOMETRY, names.BEARING)
# Topics with hundreds of messages a second, which rosbags decodes three times as fast as rclpy.
FREQUENT = (names.ODOMETRY, names.TRUE_TARGET, names.TRUE_RIG)


class BagRecord(NamedTuple):
    """A message of a bag.

    Parameters:
        name: the rig's name of its topic.
        arrival (s): time at which it arrived.
        message: the message in the rig's type; None when it was not decoded.
        data: the recorded message in CDR; empty when it was converted from another type.
        segment: number of the part of the bag without a jump of the clock that it belongs to.
    """

    name: str
    arrival: float
    message: Any
    data: bytes
    segment: int = 0


class Feed:
    """Yields the records of a bag's topics in order of time, in segments between which the clock was set or nothing recorded.

    The arrival of a record is its time of recording. When all stamps of a bag are of another clock, such as that of a
    simulation, or of a rig that is ahead of its recorder, it is the newest stamp. Arrivals rise within a segment.

    Parameters:
        bag: the bag to read.
        topics: topics of the bag, by the rig's names.
        layout: layout of audio that is recorded as bytes.
        start, stop (s): part of the recorded time to read, without what lies between segments.
        decode: whether to decode all messages; otherwise only those that are converted.

    Attributes:
        problems: number of messages that could not be read, by texts why.
        notes: where segments begin.

    Raises BagError when audio bytes have no layout, or when a type was recorded with another definition.
    """

    def __init__(self, bag: Bag, topics: Mapping[str, str], layout: AudioLayout | None = None, start: float = 0.0,
                 stop: float = math.inf, decode: bool = True) -> None:
        self._bag, self._topics = bag, dict(topics)
        self._names = {topic: name for name, topic in topics.items()}
        self._start, self._stop = start, stop
        self._layout = layout
        self._converters = {name: converter(bag, name, topic, layout) for name, topic in topics.items()}
        self._decoders = {name: bag.decoder(topic, name in FREQUENT and self._converters[name] is None)
                          for name, topic in topics.items()}
        self._decode = decode
        self._by_stamp = self._is_of_another_clock()
        self.problems: Counter[str] = Counter()
        self.notes: list[str] = []

    def __iter__(self) -> Iterator[BagRecord]:
        now, segment, begun = -math.inf, 0, -1
        self.notes = []
        for number, time, (topic, time_ns, data) in self._timed():
            if number != begun:
                if begun >= 0:
                    segment += 1
                    self.notes.append(_jump(now, time))
                    self._converters = {name: converter(self._bag, name, topic, self._layout)
                                        for name, topic in self._topics.items()}    # which may have a clock
                now, begun = -math.inf, number
            now = max(now, time)
            name = self._names[topic]
            try:
                found = self._converted(name, time_ns, data)
            except Exception as error:  # noqa: BLE001  fields of other types make libraries and converters raise any
                self._count(topic, f'{topic}: {error}')
                continue
            for message, original in found:
                yield BagRecord(name, now, message, original, segment)

    @property
    def lost(self) -> list[str]:
        """What could not be read, with the number of messages."""
        return [f'{count} message{"s" if count > 1 else ""} of {text}' for text, count in self.problems.items()]

    def _count(self, topic: str, reason: str) -> None:
        """Count a message of a topic that cannot be read for a reason."""
        told = sum(text.startswith(f'{topic}: ') for text in self.problems)
        self.problems[reason if reason in self.problems or told < MOST_REASONS else f'{topic}, for further reasons'] += 1

    def _converted(self, name: str, time_ns: int, data: bytes) -> list[tuple[Any, bytes]]:
        """Messages in the rig's type, as far as they are decoded, each with the recorded bytes where those are of that type."""
        if len(data) < SHORTEST:
            raise BagError(f'{len(data)} bytes are no message')
        convert = self._converters[name]
        if convert is None:
            return [(self._decoders[name](data) if self._decode else None, data)]
        return [(message, b'') for message in convert(self._decoders[name](data), time_ns)]

    def _timed(self) -> Iterator[tuple[int, float, Row]]:
        """Messages with the number of their segment and their time (s) on the clock that counts."""
        if not self._by_stamp:
            return ((number, row[1] / SECOND, row) for number, row in self._rows(self._names))
        clocked = [topic for topic, name in self._names.items() if name in CLOCKED]
        _, first = next(self._rows(clocked), (0, None))
        if first is None:    # behind the last stamp
            return iter(())
        return self._stamped((row for _, row in self._rows(self._names)), stamp_of(first[2]))

    def _rows(self, topics: Collection[str]) -> Iterator[tuple[int, Row]]:
        """Messages of the part to read, with the number of their segment."""
        before = 0.0
        for number, segment in enumerate(self._bag.segments):
            length = (segment.end_ns - segment.start_ns) / SECOND
            first, last = max(self._start - before, 0.0), min(self._stop - before, length)
            if first <= length and (last > 0.0 or last == length):
                end_ns = segment.end_ns + 1 if last == length else segment.start_ns + round(last * SECOND)
                for row in self._bag.messages(topics, segment.start_ns + round(first * SECOND), end_ns, segment):
                    yield number, row
            before += length

    def _stamped(self, rows: Iterable[Row], now: float) -> Iterator[tuple[int, float, Row]]:
        """The same by the stamps, from the first one (s) on. A single one may be wrong: two that agree begin a segment."""
        segment = 0
        waiting: list[Row] = []
        for row in rows:
            clocked = self._names[row[0]] in CLOCKED
            time = stamp_of(row[2]) if clocked else now
            if clocked and _jumps(now, time):
                before = next((stamp_of(other[2]) for other in reversed(waiting) if self._names[other[0]] in CLOCKED), None)
                if before is not None and not _jumps(before, time):
                    segment, now = segment + 1, before
            if (_jumps(now, time) or (waiting and not clocked)) and len(waiting) < MOST_WAITING:
                waiting.append(row)
                continue
            yield from ((segment, now, other) for other in waiting)
            waiting = []
            now = now if _jumps(now, time) else max(now, time)
            yield segment, now, row
        yield from ((segment, now, other) for other in waiting)

    def _is_of_another_clock(self) -> bool:
        """Whether all stamps are of another clock than the times of recording: nothing is recorded before it was stamped.

        A stamp of zero tells of none: its publisher has not set it, or a simulation begins.
        """
        clocked = {topic for name, topic in self._topics.items()
                   if name in CLOCKED and self._bag.topics[topic].kind not in names.WITHOUT_HEADER}
        told = set[str]()
        for topic, time_ns, data in self._bag.messages(clocked) if clocked else ():
            if topic not in told and (stamp := stamp_of(data)):
                if is_of_clock(stamp, time_ns / SECOND):
                    return False
                told.add(topic)
                if told == clocked:
                    break
        return bool(told)


def _jumps(now: float, time: float) -> bool:
    """Whether a clock that showed `now` (s, -inf before the first time) was set before it showed `time` (s)."""
    return math.isfinite(now) and not now - CLOCK_TOLERANCE_S <= time <= now + GAP_NS / SECOND


def _jump(now: float, time: float) -> str:
    apart = time - now
    what = f'{abs(apart):.1f} s' if abs(apart) < 86_400.0 else f'{abs(apart) / 86_400.0:.1f} days'
    return (f'the clock goes on {what} {"later" if apart > 0.0 else "earlier"} after {now:.1f} s: it was set, or nothing was '
            'recorded; a new segment begins, and what lies between is left out')


def stamp_of(data: bytes) -> float:
    """The stamp in s of a message in CDR that begins with a std_msgs/Header; 0 when there are too few bytes."""
    if len(data) < 12:
        return 0.0
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] else '>iI', data, 4)
    return seconds + 1e-9 * nanoseconds
