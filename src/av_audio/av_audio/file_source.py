"""Reading of sound files, and a source that plays one in real time.

Of wav files of recorders that were killed, the header does not know of the samples that follow it.
Sources: Multimedia Programming Interface and Data Specifications 1.0 (IBM and Microsoft, 1991), EBU Tech 3306 (RF64).
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np
import soundfile
from numpy.typing import NDArray

from av_audio.ring_buffer import RingBuffer
from av_common.files import check_file, one_line
from av_common.microphone_array import MOST_MICROPHONES

SAMPLE_RATES = (1000, 384_000)    # Hz; converters for sound have 8 to 384 kHz
FRAMES_UNKNOWN = 2**63 - 1    # `frames` of a file whose header states no length
UNKNOWN = struct.pack('<I', 2**32 - 1)    # size of data of a wav file that go on to the end of the file
_CHUNK = struct.Struct('<4sI')
MOST_SAMPLES = 50_000_000    # of a file that is read as a whole (200 MB): two channels at 48 kHz for nine minutes


def pick_channels(available: int, channels: Sequence[int], source: str) -> list[int]:
    """Validate a choice of channels.

    Parameters:
        available: number of channels of the source.
        channels: wanted channels in order; empty for all.
        source: name of the source for messages.

    Raises ValueError for a channel that does not exist or is given twice.
    """
    wrong = [channel for channel in channels if not 0 <= channel < available]
    if wrong:
        raise ValueError(f'channels={list(channels)}: {source} has channels 0..{available - 1}, not {wrong}')
    if len(set(channels)) < len(channels):
        raise ValueError(f'channels={list(channels)}: each microphone needs a separate channel')
    return list(channels) or list(range(available))


def read_sound(path: str | Path, channels: Sequence[int] = ()) -> tuple[NDArray, int]:
    """Samples (n, m) in float32 and sample rate of a file that libsndfile reads. Raises OSError or ValueError.

    Parameters:
        path: the file, of at most MOST_SAMPLES in all channels.
        channels: channels of the file in the order of the microphones; empty for all.
    """
    with open_sound(path) as file:
        picked = pick_channels(file.channels, channels, str(path))
        blocks = []
        for block in blocks_of(file, file.samplerate):
            blocks.append(block[:, picked])
            if len(blocks) * file.samplerate * file.channels > MOST_SAMPLES:
                raise ValueError(f'sound file {path} has more than {len(blocks)} s of {file.channels} channels, '
                                 f'expected at most {MOST_SAMPLES} samples')
        if not blocks:
            raise ValueError(f'sound file {path} is empty')
        return np.concatenate(blocks), file.samplerate


def blocks_of(file: soundfile.SoundFile, samples: int) -> Iterator[NDArray]:
    """Blocks (n, channels) in float32 of an open file, the last one shorter; a file that breaks off ends there.

    Parameters:
        file: from `open_sound`.
        samples: samples per block.
    """
    while len(block := read_block(file, samples)):
        yield block


def read_block(file: soundfile.SoundFile, samples: int) -> NDArray:
    """The next samples (n, channels) in float32; fewer, or none, at the end of the file or where it breaks off.

    Parameters:
        file: from `open_sound`.
        samples: number of samples.
    """
    block = np.full((samples, file.channels), np.nan, np.float32)
    try:
        return np.asarray(file.read(out=block))
    except soundfile.LibsndfileError:    # a recorder was killed within a compressed block, or before it could state the length
        return block[:int(np.isfinite(block).all(axis=1).cumprod().sum())]


def open_sound(path: str | Path) -> soundfile.SoundFile:
    """Open a sound file. Raises OSError or ValueError that names the file and what is wrong."""
    path = check_file(path, kind='sound file')
    try:
        file = soundfile.SoundFile(unfinished_wav(path) or path)
    except (soundfile.LibsndfileError, TypeError, ValueError) as error:    # a file without header has no rate
        raise OSError(f'sound file {path} cannot be read: {one_line(getattr(error, "error_string", error))}') from error
    for name, (low, high) in {'samplerate': SAMPLE_RATES, 'channels': (1, MOST_MICROPHONES)}.items():
        if not low <= (value := getattr(file, name)) <= high:
            file.close()
            raise ValueError(f'sound file {path}: {name} is {value}, expected {low} to {high}')
    return file


class FileSource:
    """Plays a sound file into a ring buffer in real time: a block is written once its last sample is due.

    Parameters:
        path: file that libsndfile reads.
        channels: channels of the file in the order of the microphones; empty for all.
        block_samples: samples per block.
        loop: continue with the beginning at the end of the file, without a gap.
        now: clock of the stamps, in s.

    Raises OSError or ValueError when the file or the channels cannot be used.
    """

    def __init__(self, path: str | Path, channels: Sequence[int] = (), block_samples: int = 1600, loop: bool = False,
                 now: Callable[[], float] = time.time) -> None:
        self._path, self._file = path, open_sound(path)
        self._picked = pick_channels(self._file.channels, channels, str(path))
        self._block = block_samples
        self._loop = loop
        self._now = now
        self._begin = 0.0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.sample_rate: int = self._file.samplerate
        self.channels = len(self._picked)
        self.finished = False
        if not len(read_block(self._file, 1)):
            raise ValueError(f'sound file {path} is empty')

    def start(self, buffer: RingBuffer, begin: float | None = None) -> None:
        """Start a thread that writes into the buffer.

        Parameters:
            buffer: takes the samples.
            begin (s): when the file begins, on the clock `now`; None for now. What should have sounded by now is left out.
        """
        now = self._now()
        self._begin = now if begin is None else begin
        self._stop.clear()
        self.finished = False
        self._thread = threading.Thread(target=self._play, args=(buffer, self._begin - now), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread. `start` may be called again and starts at the beginning of the file."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """Stop and close the file."""
        self.stop()
        self._file.close()

    def time_of(self, sample: int) -> float:
        """Capture time in s of a sample, on the clock `now`."""
        return self._begin + sample / self.sample_rate

    def _play(self, buffer: RingBuffer, lead: float) -> None:
        """Write each block when its last sample is due. The first sample is due in `lead` s, or was before."""
        begin = time.monotonic() + lead
        sent = max(0, int(-lead * self.sample_rate) // self._block * self._block)
        for samples in self._blocks(sent):
            due = begin + (sent + len(samples)) / self.sample_rate
            if self._stop.wait(max(0.0, due - time.monotonic())):
                return
            buffer.write(samples, sent)
            sent += len(samples)
        self.finished = True

    def _blocks(self, first: int) -> Iterator[NDArray]:
        """Blocks (n, channels) from a sample of the stream on; they also end where the file is gone, as with its disk."""
        with suppress(OSError, ValueError, soundfile.LibsndfileError):
            self._rewind()
            if self._file.frames == FRAMES_UNKNOWN:  # nor can it seek beyond
                for _ in range(first // self._block):
                    if not len(self._read_block()):
                        return
            else:
                self._file.seek(first % self._file.frames if self._loop else min(first, self._file.frames))
            while len(block := self._read_block()):
                yield block

    def _read_block(self) -> NDArray:
        """The next block (n, channels); shorter at the end of the file, empty after it. A loop joins end and beginning."""
        blocks = []
        missing, rewound = self._block, False
        while missing:
            block = read_block(self._file, missing)
            blocks.append(block)
            missing -= len(block)
            if missing and (not self._loop or (rewound and not len(block))):  # one that was truncated to nothing has no loop
                break
            if missing:
                self._rewind()
                rewound = True
        return np.concatenate(blocks)[:, self._picked]

    def _rewind(self) -> None:
        """Go to the beginning, which libsndfile cannot after the end of a file that breaks off or states no length.

        Raises ValueError for a file of other sound that has taken its place.
        """
        self._file.close()
        known, self._file = self._file, open_sound(self._path)
        if (self._file.samplerate, self._file.channels) != (known.samplerate, known.channels):
            raise ValueError(f'sound file {self._path} has another rate or other channels than before')


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
