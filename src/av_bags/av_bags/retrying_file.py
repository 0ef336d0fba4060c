"""A new file that keeps data which the disk refuses, and writes them later."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


class RetryingFile:
    """Collects data until `commit`, which can be repeated after a failure without losing or repeating bytes.

    On a full disk the file ends early, and grows from there as soon as there is room.

    Parameters:
        path: the file to create.

    Raises OSError when the file exists or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.fdopen(self._create(path), 'r+b', buffering=0)
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

    @staticmethod
    def _create(path: Path) -> int:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)


class UnnamedFile(RetryingFile):
    """The same without a name: it vanishes with this object, or with the process.

    Parameters:
        path: the folder, whose disk takes the data.
    """

    @staticmethod
    def _create(path: Path) -> int:
        descriptor, name = tempfile.mkstemp(dir=path)
        Path(name).unlink()
        return descriptor
