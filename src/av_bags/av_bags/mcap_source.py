"""Reads mcap files (https://mcap.dev/spec), whole or damaged: by their index, or from the beginning as far as they go."""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream

# What reading bytes that are no longer those that were written may end in.
DAMAGE = (McapError, EOFError, struct.error, ValueError, RuntimeError, OSError, MemoryError, KeyError)
PLAUSIBLE_RECORD_BYTES = 2**31
FOREVER = 2**63 - 1
# The library takes ten times as long to part a chunk.
_HEAD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<xQH4xQ8x')  # of the head again the length, channel, of sequence, log and publish time the second
_HEAD_BYTES, _MESSAGE_BYTES, _MESSAGE_OPCODE = _HEAD.size, _MESSAGE.size, int(Opcode.MESSAGE)

Row = tuple[str, int, bytes]  # topic, log time in ns, data
_TIME = itemgetter(1)


@dataclass(frozen=True)
class _Stretch:
    """A chunk at `offset`; `channels` (all when empty) have messages in it."""

    offset: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] = frozenset()


class McapSource:
    """One file.

    channels: by number; schemas: by the number that channels name; counts: messages by channel; problems: what is
    damaged. Messages outside of chunks are held in memory.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: dict[int, int] = {}
        self.problems: dict[str, None] = {}
        self.start_ns, self.end_ns = FOREVER, 0
        self._stretches: list[_Stretch] = []
        self._loose: list[tuple[int, int, bytes]] = []  # with the channel for the topic
        with path.open('rb') as file:
            try:
                self._read_index(file)
            except DAMAGE:
                self._survey(file)
        self._stretches.sort(key=lambda stretch: stretch.start_ns)

    def lumps(self, topics: Mapping[int, str], start_ns: int = 0, stop_ns: int = FOREVER) -> Iterator[list[Row]]:
        """Messages of channels in order of time, from `start_ns` until before `stop_ns`, a chunk's or so at a time.

        `topics` are the channels' names in the rows.
        """
        wanted = frozenset(topics)
        waiting = [(topics[channel], time_ns, data) for channel, time_ns, data in self._loose if channel in wanted]
        with self.path.open('rb') as file:
            for stretch in self._stretches:
                if stretch.start_ns >= stop_ns or stretch.end_ns < start_ns or not (
                        wanted & stretch.channels or not stretch.channels):
                    continue
                waiting.sort(key=_TIME)
                ready = bisect_left(waiting, stretch.start_ns, key=_TIME)
                yield _between(waiting[:ready], start_ns, stop_ns)
                waiting = waiting[ready:] + self._rows(file, stretch, topics)
        waiting.sort(key=_TIME)
        yield _between(waiting, start_ns, stop_ns)

    def _rows(self, file: BinaryIO, stretch: _Stretch, topics: Mapping[int, str]) -> list[Row]:
        rows: list[Row] = []
        unpack = _MESSAGE.unpack_from
        try:
            file.seek(stretch.offset + _HEAD_BYTES)
            stream, size = get_chunk_data_stream(Chunk.read(ReadDataStream(file)), validate_crc=True)
            content, at = stream.read(size), 0
            while at < size:
                if content[at] == _MESSAGE_OPCODE:
                    length, channel, time_ns = unpack(content, at)
                    begin, at = at + _MESSAGE_BYTES, at + _HEAD_BYTES + length
                    if channel in topics:
                        rows.append((topics[channel], time_ns, content[begin:at]))
                else:
                    at += _HEAD_BYTES + _HEAD.unpack_from(content, at)[1]
        except DAMAGE as error:
            self._complain(stretch.offset, error)
        return rows

    def _read_index(self, file: BinaryIO) -> None:
        """Take the summary at the file's end. Raises one of DAMAGE where there is none that says all."""
        summary = make_reader(file).get_summary()
        if summary is None or summary.statistics is None or not summary.chunk_indexes:
            raise ValueError('no index')
        if set(summary.statistics.channel_message_counts) - set(summary.channels):
            raise ValueError('the index leaves channels out')
        self.channels, self.schemas = summary.channels, summary.schemas
        self.counts = summary.statistics.channel_message_counts
        self.start_ns, self.end_ns = summary.statistics.message_start_time, summary.statistics.message_end_time
        self._stretches = [_Stretch(index.chunk_start_offset, index.message_start_time, index.message_end_time,
                                    frozenset(index.message_index_offsets)) for index in summary.chunk_indexes]

    def _survey(self, file: BinaryIO) -> None:
        """Find what is in the file and can be read."""
        file.seek(0)
        records = StreamReader(file, emit_chunks=True, record_size_limit=PLAUSIBLE_RECORD_BYTES).records
        offset = 0
        while True:
            try:
                record = next(records, None)
            except DAMAGE as error:
                self.problems[f'{self.path.name} ends after byte {offset} ({str(error) or type(error).__name__})'] = None
                return
            if record is None or isinstance(record, DataEnd):
                return
            if isinstance(record, Chunk):
                self._survey_chunk(record, offset)
            else:
                self._note(record)
                if isinstance(record, Message):
                    self._loose.append((record.channel_id, record.log_time, record.data))
            offset = file.tell()

    def _survey_chunk(self, chunk: Chunk, offset: int) -> None:
        try:
            records = breakup_chunk(chunk, validate_crc=True)
        except DAMAGE as error:
            self._complain(offset, error)
            return
        for record in records:
            self._note(record)
        self._stretches.append(_Stretch(offset, chunk.message_start_time, chunk.message_end_time))

    def _note(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Message):
            self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            self.start_ns, self.end_ns = min(self.start_ns, record.log_time), max(self.end_ns, record.log_time)

    def _complain(self, offset: int, error: Exception) -> None:
        self.problems[f'{self.path.name}: the chunk at byte {offset} is damaged ({error})'] = None


def _between(rows: list[Row], start_ns: int, stop_ns: int) -> list[Row]:
    """Of rows in order of time those from `start_ns` until before `stop_ns`."""
    return rows[bisect_left(rows, start_ns, key=_TIME):bisect_left(rows, stop_ns, key=_TIME)]
