"""Writes mcap (https://mcap.dev/spec) several times as fast as the library whose records it is made of.

Only messages and their index are packed here, those of a chunk at once: the library takes two dozen calls for each.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import Protocol
from zlib import crc32

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

MAGIC = b'\x89MCAP0\r\n'
# Named in the file; a version would make equal bags differ.
LIBRARY = 'av_fusion'
# What precedes a message's data; the length is of what follows itself.
_HEAD = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4'), ('log_time', '<u8'),
                  ('publish_time', '<u8')])
_HEAD_BYTES, _LENGTH_END = _HEAD.itemsize, 9
# Opcode, length of the rest, channel, length of what follows.
_INDEX = struct.Struct('<BQHI')
Message = tuple[int, int, bytes | memoryview]  # channel, time in ns, data
AT_ONCE = 200  # messages: a chunk may get as many too large
COMPRESSORS = {'': bytes, 'lz4': lz4.frame.compress, 'zstd': zstandard.compress}


class Stream(Protocol):
    """Where the bytes go."""

    def write(self, data: bytes) -> int:
        """Take all of the data."""

    def tell(self) -> int:
        """How many bytes were taken so far."""


class McapFile:
    """A file of chunks with an index. A chunk holds what came since the last, and names its channels itself."""

    def __init__(self, stream: Stream, compression: str = '', chunk_bytes: int = 512 * 1024) -> None:
        self._stream, self._compression, self._chunk_bytes = stream, compression, chunk_bytes
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: list[int] = []  # messages by channel in the chunks that are complete
        self._chunks: list[ChunkIndex] = []
        self._start_chunk()
        stream.write(MAGIC)
        self._write(Header(profile='ros2', library=LIBRARY))

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        waiting = Counter(channel for channel, _, _ in self._messages)
        return {channel.topic: count + waiting[channel.id]
                for channel, count in zip(self._channels, self._counts, strict=True)}

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of the first and the last message in the chunks that are complete; zeros before there are any."""
        return (min((chunk.message_start_time for chunk in self._chunks), default=0),
                max((chunk.message_end_time for chunk in self._chunks), default=0))

    def add_schema(self, name: str, encoding: str, text: bytes) -> int:
        """Announce a type of messages; returns its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=text))
        self._announced += _bytes_of(self._schemas[-1])
        return self._schemas[-1].id

    def add_channel(self, topic: str, schema: int, metadata: dict[str, str]) -> int:
        """Announce a topic of messages in CDR; returns its number."""
        self._channels.append(Channel(id=len(self._channels) + 1, topic=topic, message_encoding='cdr', metadata=metadata,
                                      schema_id=schema))
        self._counts.append(0)
        self._announced += _bytes_of(self._channels[-1])
        return self._channels[-1].id

    def add_messages(self, messages: Sequence[Message]) -> bool:
        """Append messages; whether they filled a chunk, which is then written."""
        filled = False
        for first in range(0, len(messages), AT_ONCE):
            some = messages[first:first + AT_ONCE]
            self._messages += some
            self._size += sum(len(data) for _, _, data in some) + _HEAD_BYTES * len(some)
            if self._size > self._chunk_bytes:
                self.end_chunk()
                filled = True
        return filled

    def end_chunk(self) -> None:
        """Write what came so far, so that it can be read from the stream."""
        if not self._messages:
            return
        content, index = self._pack()
        start_ns = min(int(entries[:, 0].min()) for entries in index.values())
        end_ns = max(int(entries[:, 0].max()) for entries in index.values())
        packed = COMPRESSORS[self._compression](content)
        chunk = Chunk(compression=self._compression, data=packed, message_start_time=start_ns, message_end_time=end_ns,
                      uncompressed_crc=crc32(content), uncompressed_size=len(content))
        begin = self._stream.tell()
        self._write(chunk)
        indices_begin = self._stream.tell()
        offsets = {}
        for channel, entries in index.items():
            offsets[channel] = self._stream.tell()
            self._stream.write(_message_index(channel, entries))
        self._chunks.append(ChunkIndex(
            message_start_time=chunk.message_start_time, message_end_time=chunk.message_end_time, chunk_start_offset=begin,
            chunk_length=indices_begin - begin, message_index_offsets=offsets,
            message_index_length=self._stream.tell() - indices_begin, compression=self._compression,
            compressed_size=len(packed), uncompressed_size=len(content)))
        self._start_chunk()

    def finish(self) -> None:
        """Write the last chunk and the summary."""
        self.end_chunk()
        self._write(DataEnd(data_section_crc=0))
        summary = self._stream.tell()
        groups = []
        for opcode, records in ((Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels),
                                (Opcode.STATISTICS, [self._statistics()]), (Opcode.CHUNK_INDEX, self._chunks)):
            begin = self._stream.tell()
            for record in records:
                self._write(record)
            if records:
                groups.append(SummaryOffset(opcode, begin, self._stream.tell() - begin))
        offsets = self._stream.tell()
        for group in groups:
            self._write(group)
        self._write(Footer(summary_start=summary, summary_offset_start=offsets, summary_crc=0))
        self._stream.write(MAGIC)

    def _statistics(self) -> Statistics:
        start_ns, end_ns = self.span_ns
        return Statistics(
            message_count=sum(self._counts), schema_count=len(self._schemas), channel_count=len(self._channels),
            attachment_count=0, metadata_count=0, chunk_count=len(self._chunks),
            message_start_time=start_ns, message_end_time=end_ns,
            channel_message_counts={channel.id: count for channel, count in zip(self._channels, self._counts, strict=True)})

    def _start_chunk(self) -> None:
        self._announced = b''
        self._messages: list[Message] = []
        self._size = 0

    def _pack(self) -> tuple[bytes, dict[int, NDArray]]:
        """Content of the chunk, and times and offsets (n, 2) of the messages of each channel."""
        channels, times, data = zip(*self._messages, strict=True)
        sizes = _HEAD_BYTES + np.fromiter(map(len, data), np.int64, len(data))
        offsets = len(self._announced) + np.cumsum(sizes) - sizes
        heads = np.empty(len(data), _HEAD)
        heads['opcode'], heads['length'], heads['channel'] = Opcode.MESSAGE, sizes - _LENGTH_END, channels
        heads['log_time'] = heads['publish_time'] = times
        index = {}
        for channel in dict.fromkeys(channels):
            of_it = np.flatnonzero(heads['channel'] == channel)
            heads['sequence'][of_it] = self._counts[channel - 1] + np.arange(len(of_it))
            self._counts[channel - 1] += len(of_it)
            index[channel] = np.stack([heads['log_time'][of_it], offsets[of_it].astype('<u8')], 1)
        parts = zip(heads.view(f'V{_HEAD_BYTES}').tolist(), data, strict=True)
        return b''.join((self._announced, *chain.from_iterable(parts))), index

    def _write(self, record: McapRecord) -> None:
        self._stream.write(_bytes_of(record))


def _message_index(channel: int, entries: NDArray) -> bytes:
    content = entries.tobytes()
    return _INDEX.pack(Opcode.MESSAGE_INDEX, len(content) + 6, channel, len(content)) + content


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
