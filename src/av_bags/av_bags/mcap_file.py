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
LIBRARY = 'av_bags'
# What precedes a message's data; the length is of what follows itself.
_HEAD = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4'), ('log_time', '<u8'),
                  ('publish_time', '<u8')])
_HEAD_BYTES, _LENGTH_END = _HEAD.itemsize, 9
# Opcode, length of the rest, channel, length of what follows.
_INDEX = struct.Struct('<BQHI')
Message = tuple[int, int, bytes | memoryview]  # channel, time in ns, data
BULKY_BYTES = 4096  # topics whose first message is larger have chunks of their own
COMPRESSORS = {'': bytes, 'lz4': lz4.frame.compress, 'zstd': zstandard.compress}


class Stream(Protocol):
    """Where the bytes go."""

    def write(self, data: bytes) -> int:
        """Take all of the data."""

    def tell(self) -> int:
        """How many bytes were taken so far."""


class McapFile:
    """A file of chunks with an index.

    Pictures and sound have chunks of their own, so that whoever reads the rest need not unpack them.
    """

    def __init__(self, stream: Stream, compression: str = '', chunk_bytes: int = 512 * 1024) -> None:
        self._stream, self._compression, self._chunk_bytes = stream, compression, chunk_bytes
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: list[int] = []  # messages by channel in the chunks that are complete
        self._chunks: list[ChunkIndex] = []
        self._announced = b''  # schemas and channels that no chunk holds yet
        self._bulky: dict[int, bool] = {}  # by channel
        self._waiting: dict[bool, list[Message]] = {False: [], True: []}
        self._sizes = {False: 0, True: 0}
        stream.write(MAGIC)
        self._write(Header(profile='ros2', library=LIBRARY))

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        waiting = Counter(channel for messages in self._waiting.values() for channel, _, _ in messages)
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
        for message in messages:
            channel, _, data = message
            bulky = self._bulky.setdefault(channel, len(data) > BULKY_BYTES)
            self._waiting[bulky].append(message)
            self._sizes[bulky] += len(data) + _HEAD_BYTES
            if self._sizes[bulky] > self._chunk_bytes:
                self._write_chunk(bulky)
                filled = True
        return filled

    def end_chunks(self) -> None:
        """Write what came so far, so that it can be read from the stream."""
        for bulky, messages in self._waiting.items():
            if messages:
                self._write_chunk(bulky)

    def _write_chunk(self, bulky: bool) -> None:
        content, index = self._pack(self._waiting[bulky])
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
        self._announced, self._waiting[bulky], self._sizes[bulky] = b'', [], 0

    def finish(self) -> None:
        """Write the last chunk and the summary."""
        self.end_chunks()
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

    def _pack(self, messages: list[Message]) -> tuple[bytes, dict[int, NDArray]]:
        """Content of a chunk, and times and offsets (n, 2) of the messages of each channel."""
        channels, times, data = zip(*messages, strict=True)
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
