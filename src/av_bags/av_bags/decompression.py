"""Decompression with limits: what a bag of a few kilobytes can make of itself stays small.

`limit_rosbags` puts these functions in the place of those of the library, which trust the content.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
from rosbags.rosbag2 import storage_mcap

from av_common.files import MEGABYTE

MOST_BYTES = 500 * MEGABYTE    # of a chunk or a message; that of a camera has a few
MOST_EXPANSION = 100           # of a compressed file, for its size
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'    # RFC 8878; CDR begins with a zero
SCHEMAS = ('ros2msg', 'ros2idl', 'omgidl')    # encodings that rosbags knows
_zstd = storage_mcap.zstd      # of the standard library, or its backport


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """The content of a chunk. Raises ValueError where it is damaged, too large, or not of the size that it claims.

    Parameters:
        data: the compressed bytes.
        compression: lz4 or zstd; empty for none.
        size (bytes): claimed size of the content.
    """
    if size > MOST_BYTES:
        raise ValueError(f'a chunk of {size / MEGABYTE:.0f} MB, expected at most {MOST_BYTES / MEGABYTE:.0f} MB')
    if not compression:
        return data
    makers: dict[str, Callable[[], Any]] = {'lz4': lz4.frame.LZ4FrameDecompressor, 'zstd': _zstd.ZstdDecompressor}
    if compression not in makers:
        raise ValueError(f'chunk compression {compression[:40]!r} is not known, expected lz4 or zstd')
    try:
        content: bytes = makers[compression]().decompress(data, max_length=size + 1)
    except Exception as error:
        raise ValueError(f'a chunk that is no {compression}: {error}') from error  # the libraries' own errors
    if len(content) != size:
        raise ValueError(f'a chunk of {"more" if len(content) > size else "less"} than the {size} bytes that it claims')
    return content


def limit_rosbags() -> None:
    """Make rosbags use these limits, in this process, and open files that hold topics of others, too."""
    for compression in ('lz4', 'zstd'):
        storage_mcap.DECOMPRESSORS[compression] = lambda data, size, kind=compression: decompress(data, kind, size)
    known = storage_mcap.get_msgdef
    storage_mcap.get_msgdef = lambda schema: known(schema if schema and schema.encoding in SCHEMAS else None)


def message(data: bytes) -> bytes:
    """A message that was compressed by itself. Raises ValueError where it is damaged or too large."""
    try:
        content: bytes = _zstd.ZstdDecompressor().decompress(data, max_length=MOST_BYTES + 1)
    except _zstd.ZstdError as error:
        raise ValueError(f'a message that is no zstd: {error}') from error
    if len(content) > MOST_BYTES:
        raise ValueError(f'a message of more than {MOST_BYTES / MEGABYTE:.0f} MB')
    return content


def expand(path: Path, copy: Path) -> str:
    """Decompress a file that was compressed as a whole, as far as it goes; returns where it breaks off, or nothing.

    Raises ValueError where it becomes too large.
    """
    left = MOST_BYTES + MOST_EXPANSION * path.stat().st_size
    with _zstd.open(path, 'rb') as content, copy.open('wb') as out:
        while True:
            try:
                data = content.read(MEGABYTE)
            except Exception as error:  # noqa: BLE001  the library's own
                return f'{path.name} breaks off after {out.tell()} bytes ({error})'
            left -= len(data)
            if left < 0:
                raise ValueError(f'{path.name}: a file that becomes more than {MOST_EXPANSION} times as large as it is')
            if not data:
                return ''
            out.write(data)
