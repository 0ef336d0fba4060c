"""The index of a long bag's chunks, outside of memory until the bag is finished."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex

from av_bags.retrying_file import UnnamedFile

COMMIT_BYTES = 64 * 1024


class _Records:
    """Serialised records, with the method of a record that `mcap.writer.Writer.finish` calls."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def write(self, builder: RecordBuilder) -> None:
        builder.write(self._data)


class ChunkIndexes:
    """Takes the place of the list in which `mcap.writer.Writer` collects a `ChunkIndex` of 2 kB for every chunk.

    The records wait in a file without a name, written as in the bag. While the disk refuses them, they wait in memory.

    Parameters:
        folder: of the bag.

    Raises OSError where no file can be created.
    """

    def __init__(self, folder: Path) -> None:
        self._file = UnnamedFile(folder)

    def append(self, index: ChunkIndex) -> None:
        """Add the index of a chunk."""
        builder = RecordBuilder()
        index.write(builder)
        self._file.write(builder.end())
        if self._file.waiting >= COMMIT_BYTES:
            with suppress(OSError):
                self._file.commit()

    def __iter__(self) -> Iterator[_Records]:
        yield _Records(self._file.content())

    def close(self) -> None:
        """Give the file back."""
        self._file.close()
