"""Recovers the readable messages of a damaged mcap file, such as one left by a killed recorder."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from av_bags.decompression import decompress

# Errors that reading damaged bytes can raise.
DAMAGE = (McapError, EOFError, struct.error, ValueError, RuntimeError, OSError, MemoryError, KeyError)
PLAUSIBLE_RECORD_BYTES = 2**31


def salvage(path: Path, copy: Path) -> list[str]:
    """Copy all readable messages to a new file, and return descriptions of the damage.

    A damaged chunk loses only its own messages; a record of damaged length loses everything behind it.

    Parameters:
        path: the damaged file.
        copy: the file to create.

    Raises OSError.
    """
    problems: list[str] = []
    out = Writer(str(copy), compression=CompressionType.NONE)
    out.start('ros2')
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for record in _records(path, problems):
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = out.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels and record.schema_id in schemas:
            channels[record.id] = out.register_channel(record.topic, record.message_encoding, schemas[record.schema_id],
                                                       record.metadata)
        elif isinstance(record, Message) and record.channel_id in channels:
            out.add_message(channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence)
    out.finish()
    return problems


def _records(path: Path, problems: list[str]) -> Iterator[McapRecord]:
    with path.open('rb') as file:
        records = StreamReader(file, emit_chunks=True, record_size_limit=PLAUSIBLE_RECORD_BYTES).records
        offset = 0
        while True:
            try:
                record = next(records, None)
            except DAMAGE as error:
                problems.append(f'{path.name} ends after byte {offset} ({str(error) or type(error).__name__})')
                return
            if record is None or isinstance(record, DataEnd):
                return
            if isinstance(record, Chunk):
                try:
                    content = decompress(record.data, record.compression, record.uncompressed_size)
                    yield from breakup_chunk(replace(record, data=content, compression=''), validate_crc=True)
                except DAMAGE as error:
                    problems.append(f'{path.name}: the chunk at byte {offset} is damaged ({error})')
            else:
                yield record
            offset = file.tell()
