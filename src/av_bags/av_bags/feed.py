"""Records of a bag under the topic names of the rig, in its message types, with arrival times of one clock."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from av_bags import topics as names
from av_bags.converters import AudioLayout, converter
from av_bags.reader import FOREVER, Bag

SECOND = 10**9
# Stamps that differ more than this from the time of recording belong to another clock; as in fusion_node.
CLOCK_TOLERANCE_S = 2.0
# Topics with stamps of the rig's clock, by which another clock is recognised.
CLOCKED = (names.AUDIO, names.DOA, names.DETECTIONS, names.ODOMETRY, names.BEARING)
# Topics with hundreds of messages a second, which rosbags decodes three times as fast as rclpy.
FREQUENT = (names.ODOMETRY, names.TRUE_TARGET, names.TRUE_RIG)


class BagRecord(NamedTuple):
    """A message of a bag.

    Parameters:
        name: the rig's name of its topic.
        arrival (s): time at which it arrived.
        message: the message in the rig's type; None when it was not decoded.
        data: the recorded message in CDR; empty when it was converted from another type.
    """

    name: str
    arrival: float
    message: Any
    data: bytes


class Feed:
    """Yields the records of a bag's topics in order of time.

    The arrival of a record is its time of recording. When all stamps of a bag are of another clock, such as that of a
    simulation, it is the newest stamp.

    Parameters:
        bag: the bag to read.
        topics: topics of the bag, by the rig's names.
        layout: layout of audio that is recorded as bytes.
        start_ns, stop_ns (ns): part of the bag to read.
        decode: whether to decode all messages; otherwise only those that are converted.

    Attributes:
        problems: texts about messages that could not be read, as keys.

    Raises BagError when audio bytes have no layout, or when a type was recorded with another definition.
    """

    def __init__(self, bag: Bag, topics: Mapping[str, str], layout: AudioLayout | None = None, start_ns: int = 0,
                 stop_ns: int = FOREVER, decode: bool = True) -> None:
        self._bag, self._topics = bag, dict(topics)
        self._names = {topic: name for name, topic in topics.items()}
        self._start_ns, self._stop_ns = start_ns, stop_ns
        self._converters = {name: converter(bag, name, topic, layout) for name, topic in topics.items()}
        self._decoders = {name: bag.decoder(topic, name in FREQUENT and self._converters[name] is None)
                          for name, topic in topics.items()}
        self._decode = decode
        self._first_stamp = self._foreign_clock()
        self.problems: dict[str, None] = {}

    def __iter__(self) -> Iterator[BagRecord]:
        now = self._first_stamp or 0.0
        for topic, time_ns, data in self._bag.messages(self._names, self._start_ns, self._stop_ns):
            name = self._names[topic]
            time = time_ns / SECOND
            if self._first_stamp is not None:
                time = stamp_of(data) if name in CLOCKED else now
            now = max(now, time)
            convert = self._converters[name]
            if convert is None and not self._decode:
                yield BagRecord(name, now, None, data)
                continue
            try:
                message = self._decoders[name](data)
                found = [(message, data)] if convert is None else [(other, b'') for other in convert(message, time_ns)]
            except (ValueError, RuntimeError) as error:
                self.problems[f'{topic}: {error}'] = None
                continue
            for message, original in found:
                yield BagRecord(name, now, message, original)

    def _foreign_clock(self) -> float | None:
        """The first stamp (s) when all stamps are of another clock than the times of recording, else None."""
        offsets, stamps = [], []
        for name, topic in self._topics.items():
            if name in CLOCKED and self._bag.topics[topic].kind not in names.WITHOUT_HEADER:
                _, time_ns, data = next(self._bag.messages([topic], self._start_ns), (None, 0, b''))
                if data:
                    stamps.append(stamp_of(data))
                    offsets.append(abs(stamps[-1] - time_ns / SECOND))
        return min(stamps) if offsets and min(offsets) > CLOCK_TOLERANCE_S else None


def stamp_of(data: bytes) -> float:
    """The stamp in s of a message in CDR that begins with a std_msgs/Header; 0 when there are too few bytes."""
    if len(data) < 12:
        return 0.0
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] else '>iI', data, 4)
    return seconds + 1e-9 * nanoseconds
