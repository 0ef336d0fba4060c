"""When the messages of a bag were recorded: pauses, and clocks that were set while recording.

A clock that is set forward leaves a gap without messages, as a pause does. One that is set back shows in the order in which the
file holds the messages of one topic; a file that holds one topic after the other, or all in no order, is only unsorted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader

GAP_NS = 5 * 10**9        # without any message: more than a rig with sound, images or odometry ever pauses
BACK_NS = 10**9 // 2      # by which messages of a topic may be recorded out of order
MOST_STEPS = 16           # of the clock; a file with more is in no order
ROWS = 100_000  # of a query at a time: 1.6 MB
_ENTRY = np.dtype([('time', '<i8'), ('offset', '<u8')])
Block = tuple[NDArray[np.int64], NDArray[np.int64]]    # numbers of the topics (n,) and times (n,; ns)


class Segment(NamedTuple):
    """A part of a bag without a jump of the clock.

    Parameters:
        step: how often the clock was set back before.
        start_ns, end_ns (ns): times of its first and of its last message.
    """

    step: int
    start_ns: int
    end_ns: int


class Steps:
    """Counts the steps back of the clock in messages in the order of their recording."""

    def __init__(self) -> None:
        self.count = 0
        self._newest: dict[int, int] = {}

    def take(self, topic: int, time_ns: int) -> int:
        """The number of steps back until a message of a topic (its number) at a time (ns)."""
        newest = self._newest.get(topic, time_ns)
        if time_ns < newest - BACK_NS:
            self.count += 1
            self._newest = {}
        self._newest[topic] = max(time_ns, self._newest.get(topic, time_ns))
        return self.count

    def take_block(self, topics: NDArray[np.int64], times: NDArray[np.int64]) -> NDArray[np.int64]:
        """The same for messages (n,) at once."""
        newest = {int(topic): times[topics == topic] for topic in np.unique(topics)}
        if all(chosen[0] >= self._newest.get(topic, chosen[0]) - BACK_NS and np.all(np.diff(chosen) >= 0)
               for topic, chosen in newest.items()):
            for topic, chosen in newest.items():
                self._newest[topic] = max(int(chosen[-1]), self._newest.get(topic, 0))
            return np.full(len(times), self.count)
        return np.array([self.take(int(topic), int(time)) for topic, time in zip(topics, times, strict=True)], np.int64)


def recorded(reader: Reader) -> Iterator[Block]:
    """Topics and times of the messages of an open file in the order of their recording, without reading the messages."""
    storage = reader.storage
    if not isinstance(storage, McapReader):
        rows = storage.dbconn.execute('SELECT topic_id, timestamp FROM messages ORDER BY id')
        while block := [row for _, row in zip(range(ROWS), rows, strict=False)]:
            topics, times = np.array(block, np.int64).T
            yield topics, times
    elif not storage.chunks:
        for connection, time_ns, _ in reader.messages():
            yield np.array([connection.id]), np.array([time_ns])
    else:
        for chunk in sorted(storage.chunks, key=lambda chunk: chunk.chunk_start_offset):
            assert storage.bio is not None
            storage.bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
            yield _indexed(storage.bio.read(chunk.message_index_length))


def segments_of(steps: list[tuple[int, NDArray[np.int64]]]) -> list[Segment]:
    """Segments of times (n,; ns), each array with the number of steps back before it, in the order of recording."""
    spans: dict[int, list[list[int]]] = {}
    for step, times in steps:
        ordered = np.sort(times)
        ends = np.flatnonzero(np.diff(ordered) > GAP_NS)
        for first, last in zip([0, *(ends + 1)], [*ends, len(ordered) - 1], strict=True):
            _join(spans.setdefault(step, []), int(ordered[first]), int(ordered[last]))
    return [Segment(step, start, end) for step in sorted(spans) for start, end in spans[step]]


def _join(spans: list[list[int]], start: int, end: int) -> None:
    """Add a span to those of one clock, which are in order and more than GAP_NS apart."""
    near = [span for span in spans if span[0] - GAP_NS <= end and start <= span[1] + GAP_NS]
    joined = [min([start, *(span[0] for span in near)]), max([end, *(span[1] for span in near)])]
    spans[:] = sorted([*(span for span in spans if span not in near), joined])


def _indexed(data: bytes) -> Block:
    """Channels and times in the order of the messages from the message indexes of a chunk (https://mcap.dev/spec)."""
    topics, entries, place = [], [], 0
    while place + 15 <= len(data):
        length = int.from_bytes(data[place + 1:place + 9], 'little')
        found = np.frombuffer(data, _ENTRY, int.from_bytes(data[place + 11:place + 15], 'little') // 16, place + 15)
        topics.append(np.full(len(found), int.from_bytes(data[place + 9:place + 11], 'little')))
        entries.append(found)
        place += 9 + length
    joined = np.concatenate(entries) if entries else np.zeros(0, _ENTRY)
    order = np.argsort(joined['offset'], kind='stable')
    return np.concatenate([np.zeros(0, np.int64), *topics])[order].astype(np.int64), joined['time'][order]
