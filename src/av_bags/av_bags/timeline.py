"""When the messages of a bag were recorded: pauses, and clocks that were set while recording.

A clock that is set forward leaves a gap without messages, as a pause does. One that is set back shows in the order in which the
file holds the messages of one topic; a file that holds one topic after the other, or all in no order, is only unsorted.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.records import MessageIndex
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader

GAP_NS = 5 * 10**9        # without any message: more than a rig with sound, images or odometry ever pauses
BACK_NS = 10**9 // 2      # by which messages of a topic may be recorded out of order
MOST_STEPS = 16           # of the clock; a file with more is in no order


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


def recorded(reader: Reader) -> Iterator[tuple[int, int]]:
    """Topics (their numbers) and times (ns) of the messages of an open file in the order of their recording.

    Of files with an index only that is read.
    """
    storage = reader.storage
    if not isinstance(storage, McapReader):
        yield from storage.dbconn.execute('SELECT topic_id, timestamp FROM messages ORDER BY id')
    elif not storage.chunks:
        yield from ((connection.id, time_ns) for connection, time_ns, _ in reader.messages())
    else:
        for chunk in sorted(storage.chunks, key=lambda chunk: chunk.chunk_start_offset):
            assert storage.bio is not None
            storage.bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
            stream, entries = ReadDataStream(storage.bio), list[tuple[int, int, int]]()
            while stream.count < chunk.message_index_length:
                stream.read(9)    # opcode and length of a record
                index = MessageIndex.read(stream)
                entries += [(place, index.channel_id, time_ns) for time_ns, place in index.records]
            yield from (entry[1:] for entry in sorted(entries, key=itemgetter(0)))    # some writers give no places


def segments_of(steps: list[tuple[int, NDArray[np.int64]]]) -> list[Segment]:
    """Segments of times (n,; ns), each array with the number of steps back before it, in the order of recording."""
    found = []
    for step in sorted({number for number, times in steps if len(times)}):
        ordered = np.sort(np.concatenate([times for number, times in steps if number == step]))
        ends = np.flatnonzero(np.diff(ordered) > GAP_NS)
        found += [Segment(step, int(ordered[first]), int(ordered[last]))
                  for first, last in zip([0, *(ends + 1)], [*ends, len(ordered) - 1], strict=True)]
    return found
