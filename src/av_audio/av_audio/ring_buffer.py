"""Buffer of samples between one writing and one reading thread."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


class RingBuffer:
    """Holds the newest samples of a multichannel stream.

    One thread writes and never waits: when the reader is too slow, the oldest samples are overwritten and counted. The
    reader gets contiguous blocks with the index of their first sample, so that every gap, whether of the source or by
    overwriting, appears as a jump of the index. Samples are copied without a lock: the writer announces a region before
    it writes there, and the reader checks after copying that its region was not announced in the meantime.

    Parameters:
        channels: number of channels.
        capacity_bytes: size of the buffer.
        dtype: type of the samples.

    Raises ValueError when the buffer does not hold one sample of every channel.
    """

    def __init__(self, channels: int, capacity_bytes: int = 200_000, dtype: DTypeLike = np.float32) -> None:
        dtype = np.dtype(dtype)
        frames = capacity_bytes // (channels * dtype.itemsize) if channels > 0 else 0
        if frames < 1:
            raise ValueError(f'capacity_bytes={capacity_bytes} does not hold one sample of {channels} channels '
                             f'of {dtype}')
        self._data = np.zeros((frames, channels), dtype)
        self._announced = 0  # frames that the writer has written or started to write
        self._written = 0
        self._read = 0
        self._index_shifts: deque[tuple[int, int]] = deque([(0, 0)])  # from this frame on, index = frame + shift
        self._arrived = threading.Event()
        self.overwritten = 0  # frames lost because the reader was too slow

    @property
    def capacity(self) -> int:
        """Number of frames (samples of all channels) that fit."""
        return len(self._data)

    @property
    def available(self) -> int:
        """Number of frames not yet read."""
        return min(self._written - self._read, self.capacity)

    def write(self, samples: ArrayLike, first_sample: int | None = None) -> None:
        """Append samples (n, channels), from the writing thread. Raises ValueError for another shape.

        Parameters:
            samples (n, channels): the next samples.
            first_sample: index of the first of them; None continues the stream.
        """
        samples = np.asarray(samples, self._data.dtype)
        if samples.ndim != 2 or samples.shape[1] != self._data.shape[1]:
            raise ValueError(f'samples of shape {samples.shape}, expected (n, {self._data.shape[1]})')
        start = self._written
        if first_sample is not None and first_sample - start != self._index_shifts[-1][1]:
            self._index_shifts.append((start, first_sample - start))
        kept = samples[-self.capacity:]
        end = start + len(samples)
        self._announced = end
        head = (end - len(kept)) % self.capacity
        first = min(len(kept), self.capacity - head)
        self._data[head:head + first] = kept[:first]
        self._data[:len(kept) - first] = kept[first:]
        self._written = end
        self._arrived.set()

    def read(self, max_frames: int | None = None) -> tuple[int, NDArray]:
        """Oldest contiguous block, from the reading thread: index of its first sample and samples (n, channels).

        A block ends before a gap. Does not wait: n = 0 when there are no samples.
        """
        self._arrived.clear()
        while True:
            written = self._written
            oldest = max(self._read, written - self.capacity)
            shift, end = self._contiguous(oldest, written)
            if max_frames is not None:
                end = min(end, oldest + max_frames)
            positions = np.arange(oldest, end) % self.capacity
            samples = self._data[positions]
            if self._announced - self.capacity <= oldest:
                self.overwritten += oldest - self._read
                self._read = end
                return oldest + shift, samples

    def wait(self, timeout: float | None = None) -> bool:
        """Wait, in the reading thread, for samples after the last `read`; False after `timeout` seconds."""
        return self._written > self._read or self._arrived.wait(timeout)

    def _contiguous(self, start: int, written: int) -> tuple[int, int]:
        """Shift from frame to sample index at frame `start`, and the frame at which it changes, at most `written`."""
        while len(self._index_shifts) > 1 and self._index_shifts[1][0] <= start:
            self._index_shifts.popleft()
        end = self._index_shifts[1][0] if len(self._index_shifts) > 1 else written
        return self._index_shifts[0][1], min(end, written)
