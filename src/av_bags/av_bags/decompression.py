"""Decompression with limits: what a bag of a few kilobytes can make of itself stays small.

`limit_rosbags` puts these functions in the place of those of the library, which trust the content.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, BinaryIO

import lz4.frame
from rosbags.rosbag2 import reader, storage_mcap

from av_common.files import MEGABYTE

MOST_BYTES = 500 * MEGABYTE    # of a chunk or a message; that of a camera has a few
MOST_EXPANSION = 100           # of a compressed file, for its size
_zstd = storage_mcap.zstd      # of the standard library, or its backport


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """The content of a chunk. Raises ValueError where it is too large, or not of the size that it claims.

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
    content: bytes = makers[compression]().decompress(data, max_length=size + 1)
    if len(content) != size:
        raise ValueError(f'a chunk of {"more" if len(content) > size else "less"} than the {size} bytes that it claims')
    return content


def limit_rosbags() -> None:
    """Make rosbags use these limits, in this process."""
    for compression in ('lz4', 'zstd'):
        storage_mcap.DECOMPRESSORS[compression] = lambda data, size, kind=compression: decompress(data, kind, size)
    reader.zstd = SimpleNamespace(decompress=_message, open=_Expanding)


def _message(data: bytes) -> bytes:
    content: bytes = _zstd.ZstdDecompressor().decompress(data, max_length=MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f'a message of more than {MOST_BYTES / MEGABYTE:.0f} MB')
    return content


class _Expanding:
    """A compressed file that is open for reading, up to MOST_EXPANSION times its size."""

    def __init__(self, file: BinaryIO, mode: str) -> None:
        self._left = MOST_BYTES + MOST_EXPANSION * file.seek(0, 2)
        file.seek(0)
        self._content = _zstd.open(file, mode)

    def __enter__(self) -> _Expanding:
        return self

    def __exit__(self, *_: object) -> None:
        self._content.close()

    def read(self, size: int) -> bytes:
        """The next bytes. Raises ValueError where there are too many."""
        data: bytes = self._content.read(size)
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f'a file that becomes more than {MOST_EXPANSION} times as large as it is')
        return data
