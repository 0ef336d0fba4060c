"""Wav files of recorders that were killed: the header does not know of the samples that follow it.

Sources: Multimedia Programming Interface and Data Specifications 1.0 (IBM and Microsoft, 1991), EBU Tech 3306 (RF64).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

UNKNOWN = struct.pack('<I', 2**32 - 1)    # size of data that go on to the end of the file
_CHUNK = struct.Struct('<4sI')


class UnfinishedWav:
    """A file that is open for reading with some bytes of its header replaced, as `soundfile.SoundFile` takes it.

    Parameters:
        file: the file.
        at: place of the replaced bytes.
        content: what is read there.
    """

    def __init__(self, file: BinaryIO, at: int, content: bytes) -> None:
        self._file, self._at, self._content = file, at, content
        self.seek, self.tell = file.seek, file.tell
        file.seek(0)

    def read(self, size: int = -1) -> bytes:
        """The next bytes."""
        begin = self._file.tell()
        data = bytearray(self._file.read(size))
        for k, value in enumerate(self._content):
            if 0 <= self._at + k - begin < len(data):
                data[self._at + k - begin] = value
        return bytes(data)


def unfinished_wav(path: Path) -> UnfinishedWav | None:
    """A wav file with the size of its data set right; None for one that is right, and for other files. Raises OSError.

    The size is wrong where it is 0, or where what follows the data is neither the end of the file nor further chunks.
    """
    file = path.open('rb')
    kind, form = file.read(4), file.read(8)[4:]
    end = file.seek(0, 2)
    place = 12
    while kind in (b'RIFF', b'RF64') and form == b'WAVE' and place + 8 <= end:
        file.seek(place)
        name, size = _CHUNK.unpack(file.read(8))
        large = kind == b'RF64' and name == b'ds64' and place + 24 <= end
        if large:
            file.seek(place + 16)
            total, = struct.unpack('<Q', file.read(8))
        if large and total == 0:
            return UnfinishedWav(file, place + 16, struct.pack('<Q', end))
        if name == b'data':
            if kind == b'RIFF' and place + 8 < end and (size == 0 or not _ends(file, place + 8 + size, end)):
                return UnfinishedWav(file, place + 4, UNKNOWN)
            break
        place += 8 + size + size % 2
    file.close()
    return None


def _ends(file: BinaryIO, place: int, end: int) -> bool:
    """Whether a file that ends at `end` has only chunks, or nothing, from `place` on."""
    while place + 8 < end:
        file.seek(place + place % 2)
        name, size = _CHUNK.unpack(file.read(8).ljust(8, b'\0'))
        if not name.isascii() or not name.decode('ascii').isprintable():
            return False
        place += place % 2 + 8 + size
    return True
