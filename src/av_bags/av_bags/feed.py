"""Messages of a bag under the rig's names, in the rig's types, dated by one clock."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from av_bags import topics as names
from av_bags.converters import AudioLayout, Converter, converter
from av_bags.definitions import learn
from av_bags.reader import FOREVER, Bag

SECOND = 10**9
# As fusion_node: a stamp further from the clock than this is of another clock.
CLOCK_TOLERANCE_S = 2.0

# So many messages are read at a time.
LUMP = 1000
# Whose stamps must agree with the bag's times, or with each other.
CLOCKED = (names.AUDIO, names.DOA, names.DETECTIONS, names.ODOMETRY, names.BEARING)


class Piece(NamedTuple):
    """A message as recorded: the rig's name of its topic, the time now in s, when it was recorded in ns, its bytes."""

    name: str
    now: float
    time_ns: int
    data: bytes


Plain = tuple[str, float, int, bytes]  # a Piece in a tenth of the time


class Feed:
    """Yields the pieces of `topics` (the bag's, by the rig's names) in order of time.

    Now is when a message was recorded; in a bag whose stamps are all of another clock, as of a simulation, it is the
    newest stamp. `problems` says what could not be read. Raises BagError when bytes of sound come without description.
    """

    def __init__(self, bag: Bag, topics: Mapping[str, str], layout: AudioLayout | None = None, start_ns: int = 0,
                 stop_ns: int = FOREVER) -> None:
        self._bag, self._topics = bag, dict(topics)
        self._names = {topic: name for name, topic in topics.items()}
        self._start_ns, self._stop_ns = start_ns, stop_ns
        self._converters: dict[str, Converter | None] = {
            name: converter(bag, name, topic, layout) for name, topic in topics.items()}
        self._first_stamp = self._foreign_clock()
        self.problems: dict[str, None] = {}

    def __iter__(self) -> Iterator[Piece]:
        for lump in self.lumps():
            yield from map(Piece._make, lump)

    def lumps(self) -> Iterator[list[Plain]]:
        """The same as plain tuples, many at a time: there are hundreds in a second of a bag."""
        now = self._first_stamp or 0.0
        for rows in self._bag.lumps(self._names, self._start_ns, self._stop_ns, LUMP):
            lump = []
            for topic, time_ns, data in rows:
                name = self._names[topic]
                time = time_ns / SECOND
                if self._first_stamp is not None:
                    time = stamp_of(data) if name in CLOCKED else now
                now = time if time > now else now
                lump.append((name, now, time_ns, data))
            yield lump

    def is_converted(self, name: str) -> bool:
        """Whether the bag has the topic in another type than the rig's."""
        return self._converters[name] is not None

    def contents(self, pieces: Iterable[Plain]) -> Iterator[tuple[str, float, int, Any, bytes | memoryview]]:
        """The messages of pieces, as objects and as CDR of the rig's type."""
        for name, now, time_ns, data in pieces:
            for message, converted in self.meaning(name, time_ns, data):
                yield name, now, time_ns, message, converted

    def meaning(self, name: str, time_ns: int, data: bytes) -> Iterable[tuple[Any, bytes | memoryview]]:
        """The same of one piece."""
        try:
            message = self._bag.decode(self._topics[name], data)
            convert = self._converters[name]
            if convert is None:
                return [(message, data)]
            messages = convert(message, time_ns)
        except ValueError as error:
            self.problems[f'{self._topics[name]}: {error}'] = None
            return []
        return [(message, self._serialise(name, message)) for message in messages]

    def serialised(self, piece: Piece) -> Iterable[bytes | memoryview]:
        """A piece as CDR of the rig's type."""
        name, _, time_ns, data = piece
        return [data for _, data in self.meaning(name, time_ns, data)] if self.is_converted(name) else [data]

    def _serialise(self, name: str, message: Any) -> memoryview:
        kind = names.KINDS[name][0]
        return learn(kind).serialize_cdr(message, kind)

    def _foreign_clock(self) -> float | None:
        """The first stamp where all stamps are of another clock than the bag's times, else None."""
        offsets, stamps = [], []
        for name, topic in self._topics.items():
            if name in CLOCKED and self._bag.topics[topic].kind not in names.WITHOUT_HEADER:
                _, time_ns, data = next(self._bag.messages([topic], self._start_ns), (None, 0, b''))
                if data:
                    stamps.append(stamp_of(data))
                    offsets.append(abs(stamps[-1] - time_ns / SECOND))
        return min(stamps) if offsets and min(offsets) > CLOCK_TOLERANCE_S else None


def stamp_of(data: bytes) -> float:
    """The stamp in s of a message in CDR that begins with a std_msgs/Header; 0 where the bytes end early."""
    if len(data) < 12:
        return 0.0
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] else '>iI', data, 4)
    return seconds + 1e-9 * nanoseconds
