"""Messages in the order of their recording: pauses, clocks that were set meanwhile, and copies of files in that order.

A clock that is set forward leaves a gap without messages, as a pause does. One that is set back shows in the order in which the
file holds the messages of one topic; a file that holds one topic after the other, or all in no order, is only unsorted.
What can be read of a damaged mcap file, such as one left by a killed recorder, is copied. So is a file in whose course the
clock was set back, each clock to a file of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader

from av_bags.decompression import decompress

GAP_NS = 5 * 10**9        # without any message: more than a rig with sound, images or odometry ever pauses
BACK_NS = 10**9 // 2      # by which messages of a topic may be recorded out of order
MOST_STEPS = 16           # of the clock; a file with more is in no order
PLAUSIBLE_RECORD_BYTES = 2**31  # a longer record has a damaged length: chunks are some MB


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


def copy_in_order(records: Iterable[McapRecord], path: Path, most_steps: int) -> list[Path]:
    """Copy messages in the order of their recording to an mcap file, to a further one each time that the clock was set back.

    Parameters:
        records: schemas, channels and messages.
        path: the first file; the others have a number in their names.
        most_steps: largest number of further files.

    Raises OSError.
    """
    steps, copies, writers = Steps(), list[Path](), list[Writer]()
    schemas, channels = dict[int, Schema](), dict[int, Channel]()
    numbers: dict[tuple[int, int], int] = {}    # of the channels in each copy

    def begin() -> None:
        copies.append(path.with_stem(f'{path.stem}_{len(copies)}') if copies else path)
        writers.append(Writer(str(copies[-1]), compression=CompressionType.NONE))
        writers[-1].start('ros2')

    begin()
    for record in records:
        if isinstance(record, Schema):
            schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            channels.setdefault(record.id, record)
        elif isinstance(record, Message) and (channel := channels.get(record.channel_id)) and channel.schema_id in schemas:
            step = min(steps.take(channel.id, record.log_time), most_steps)
            if step == len(writers):
                begin()
            if (step, channel.id) not in numbers:
                numbers[step, channel.id] = _register(writers[step], channel, schemas[channel.schema_id])
            writers[step].add_message(numbers[step, channel.id], record.log_time, record.data, record.publish_time,
                                      record.sequence)
    for writer in writers:
        writer.finish()
    return copies


def _register(writer: Writer, channel: Channel, schema: Schema) -> int:
    """The number of a channel in a new file."""
    text = schema.data.decode('utf-8', 'replace').encode()    # comments may be in an older encoding
    number = writer.register_schema(schema.name, schema.encoding, text)
    return int(writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata))


def records_of_database(reader: Reader, problems: list[str]) -> Iterator[McapRecord]:
    """Schemas, channels and messages of an open sqlite3 file in the order of their recording, up to where it is damaged.

    Parameters:
        reader: the file.
        problems: takes a description of the damage.
    """
    for connection in reader.connections:
        encoding = 'ros2idl' if connection.msgdef.format == MessageDefinitionFormat.IDL else 'ros2msg'
        yield Schema(connection.id, connection.msgdef.data.encode(), encoding, connection.msgtype)
        yield Channel(connection.id, connection.topic, 'cdr', {}, connection.id)
    rows = reader.storage.dbconn.execute("SELECT topic_id, timestamp, data FROM messages WHERE typeof(data) = 'blob' "
                                         "AND typeof(timestamp) = 'integer' AND timestamp >= 0 ORDER BY id")
    try:
        for number, (topic, time_ns, data) in enumerate(rows):
            yield Message(topic, time_ns, data, time_ns, number)
    except Exception as error:  # noqa: BLE001  the same
        problems.append(f'{reader.path.name} is damaged ({error})')


def records_of_file(path: Path, problems: list[str]) -> Iterator[McapRecord]:
    """The records of an mcap file that can be read, in order; descriptions of the damage are added to `problems`.

    A damaged chunk loses only its own messages; a record of damaged length loses everything behind it.
    """
    with path.open('rb') as file:
        records = StreamReader(file, emit_chunks=True, record_size_limit=PLAUSIBLE_RECORD_BYTES).records
        offset, is_summary_read = 0, False
        while True:
            try:
                record = next(records, None)
            except Exception as error:  # noqa: BLE001  libraries raise any type on damaged bytes
                problems.append(f'{path.name} ends after byte {offset} ({str(error) or type(error).__name__})')
                return
            if record is None or isinstance(record, DataEnd):
                return
            if isinstance(record, Chunk):
                try:
                    content = decompress(record.data, record.compression, record.uncompressed_size)
                    yield from breakup_chunk(replace(record, data=content, compression=''), validate_crc=True)
                except Exception as error:  # noqa: BLE001  the same
                    problems.append(f'{path.name}: the chunk at byte {offset} is damaged ({error})')
                    if not is_summary_read:
                        is_summary_read = True
                        yield from _summarised(path)
            else:
                yield record
            offset = file.tell()


def _summarised(path: Path) -> list[McapRecord]:
    """Schemas and channels by the end of an mcap file: those that a damaged chunk held are of messages in other chunks, too."""
    try:
        with path.open('rb') as file:
            summary = SeekingReader(file, record_size_limit=PLAUSIBLE_RECORD_BYTES).get_summary()
    except Exception:  # noqa: BLE001  the same
        return []
    return [*summary.schemas.values(), *summary.channels.values()] if summary else []
