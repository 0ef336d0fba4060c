"""A new file that never loses what the disk refuses."""

from __future__ import annotations

import os
from pathlib import Path


class RetryingFile:
    """Collects what is written until `commit`, which can be tried again after a failure without loss or repetition.

    A full disk leaves a file that ends early, and goes on where it ended as soon as there is room. Raises OSError.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._waiting = bytearray()
        self._position = 0

    @property
    def waiting(self) -> int:
        """Bytes that are not in the file yet."""
        return len(self._waiting)

    def write(self, data: bytes) -> int:
        """Take data; never fails."""
        self._waiting += data
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Position of the next byte in the file."""
        return self._position

    def flush(self) -> None:
        """Do nothing: `commit` decides when data go to the file."""

    def commit(self) -> None:
        """Hand everything to the operating system. Raises OSError; what was refused keeps waiting."""
        while self._waiting:
            written = os.write(self._descriptor, self._waiting)
            del self._waiting[:written]

    def sync(self) -> None:
        """Have the disk keep what was committed, so that it survives a loss of power. Raises OSError."""
        os.fdatasync(self._descriptor)

    def close(self) -> None:
        """Close the file, with or without what still waits."""
        os.close(self._descriptor)
