"""Reads what can be read of a damaged mcap file: cut off, without its index, or with broken chunks."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

# What reading bytes that are no longer those that were written may end in.
DAMAGE = (McapError, EOFError, struct.error, ValueError, RuntimeError, OSError, MemoryError)
PLAUSIBLE_RECORD_BYTES = 2**31

Row = tuple[int, int, bytes]  # channel, log time in ns, data


@dataclass(frozen=True)
class _Part:
    """A stretch of the file whose messages are sorted together."""

    offset: int
    start_ns: int


class Salvage:
    """An mcap file, read from its beginning as far as it goes.

    channels: by number; definitions: by the number that channels name; counts: messages by channel; problems: what is
    damaged. Messages outside of chunks are held in memory.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.definitions: dict[int, Schema] = {}
        self.counts: dict[int, int] = {}
        self.problems: list[str] = []
        self.start_ns, self.end_ns = 2**63 - 1, 0
        self._chunks: list[_Part] = []
        self._loose: list[Row] = []
        self._survey()

    def messages(self, start_ns: int = 0, stop_ns: int = 2**63 - 1) -> Iterator[Row]:
        """Channel, log time and data of each message in order of time, from `start_ns` until before `stop_ns`."""
        parts = sorted(self._chunks, key=lambda part: part.start_ns)
        streams = [self._messages_of(part) for part in parts]
        for channel, time_ns, data in heapq.merge(*streams, sorted(self._loose, key=itemgetter(1)), key=itemgetter(1)):
            if channel >= 0 and start_ns <= time_ns < stop_ns:
                yield channel, time_ns, data

    def _messages_of(self, part: _Part) -> Iterator[Row]:
        yield -1, part.start_ns, b''  # opens the chunk no sooner than it is its turn
        with self.path.open('rb') as file:
            file.seek(part.offset)
            chunk = next(StreamReader(file, skip_magic=True, emit_chunks=True).records)
        rows = [(r.channel_id, r.log_time, r.data) for r in breakup_chunk(chunk) if isinstance(r, Message)]
        yield from sorted(rows, key=itemgetter(1))

    def _survey(self) -> None:
        """Find the chunks that can be read, and what is in them."""
        with self.path.open('rb') as file:
            reader = StreamReader(file, emit_chunks=True, record_size_limit=PLAUSIBLE_RECORD_BYTES).records
            offset = 0
            while True:
                try:
                    record = next(reader, None)
                except DAMAGE as error:
                    self.problems.append(f'{self.path.name} ends after byte {offset} ({str(error) or type(error).__name__})')
                    return
                if record is None or isinstance(record, DataEnd):
                    return
                self._take(record, offset)
                offset = file.tell()

    def _take(self, record: McapRecord, offset: int) -> None:
        if isinstance(record, Chunk):
            try:
                records = breakup_chunk(record, validate_crc=True)
            except DAMAGE as error:
                self.problems.append(f'{self.path.name}: {len(record.data)} bytes from byte {offset} on are damaged ({error})')
                return
            self._chunks.append(_Part(offset, record.message_start_time))
            for inner in records:
                self._note(inner)
        else:
            self._note(record)
            if isinstance(record, Message):
                self._loose.append((record.channel_id, record.log_time, record.data))

    def _note(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self.definitions[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Message):
            self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            self.start_ns, self.end_ns = min(self.start_ns, record.log_time), max(self.end_ns, record.log_time)
