"""A new file that keeps data which the disk refuses, and writes them later."""

from __future__ import annotations

import os
import tempfile
from io import FileIO
from pathlib import Path


class RetryingFile:
    """Collects data until `commit`, which can be repeated after a failure without losing or repeating bytes.

    On a full disk the file ends early, and grows from there as soon as there is room.

    Parameters:
        file: a new file, without a buffer, to read and write.
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self._waiting = bytearray()
        self._position = 0

    @property
    def waiting(self) -> int:
        """Number of bytes that are not in the file yet."""
        return len(self._waiting)

    def write(self, data: bytes) -> int:
        """Append data in memory; never fails."""
        self._waiting += data
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Number of bytes that were written."""
        return self._position

    def flush(self) -> None:
        """Do nothing: only `commit` writes to the file."""

    def commit(self) -> None:
        """Pass all data to the operating system. Raises OSError; the refused data are kept for the next call."""
        while self._waiting:
            written = self._file.write(self._waiting)
            del self._waiting[:written]

    def content(self) -> bytes:
        """All data that were written."""
        return os.pread(self._file.fileno(), self._position - len(self._waiting), 0) + self._waiting

    def sync(self) -> None:
        """Write committed data to the disk, so that they survive a loss of power. Raises OSError."""
        os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Close the file; data that were not committed are lost."""
        self._file.close()


def unnamed_file(folder: Path) -> RetryingFile:
    """A file on the disk of a folder that vanishes with the process. Raises OSError where none can be created."""
    return RetryingFile(tempfile.TemporaryFile(buffering=0, dir=folder))
