"""Buffer of samples between one writing and one reading thread."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


class RingBuffer:
    """Holds the newest samples of a multichannel stream.

    The writer does not wait for the reader: when that is too slow, the oldest samples are dropped and counted. The reader
    gets contiguous blocks with the index of their first sample, so that every gap, of the source or by dropping, is a jump of
    the index.

    Attributes:
        capacity: number of frames (samples of all channels) that fit.
        available: number of frames not yet read.
        overwritten: number of frames lost because the reader was too slow.

    Parameters:
        channels: number of channels.
        capacity_bytes: size of the buffer.
        dtype: type of the samples.

    Raises ValueError when the buffer does not hold one sample of every channel.
    """

    def __init__(self, channels: int, capacity_bytes: int = 200_000, dtype: DTypeLike = np.float32) -> None:
        self._empty: NDArray = np.zeros((0, channels), dtype)
        self.capacity = capacity_bytes // (channels * self._empty.itemsize) if channels > 0 else 0
        if self.capacity < 1:
            raise ValueError(f'capacity_bytes={capacity_bytes} does not hold one sample of {channels} channels '
                             f'of {self._empty.dtype}')
        self.available = self.overwritten = 0
        self._next = 0  # index that continues the stream
        self._blocks: deque[tuple[int, NDArray]] = deque()
        self._arrived = threading.Condition()

    def write(self, samples: ArrayLike, first_sample: int | None = None) -> None:
        """Append samples (n, channels), from the writing thread. Raises ValueError for another shape.

        Parameters:
            samples (n, channels): the next samples, which are copied.
            first_sample: index of the first of them; None continues the stream.
        """
        block = np.array(samples, self._empty.dtype)
        if block.ndim != 2 or block.shape[1] != self._empty.shape[1]:
            raise ValueError(f'samples of shape {block.shape}, expected (n, {self._empty.shape[1]})')
        with self._arrived:
            first = self._next if first_sample is None else first_sample
            self._next = first + len(block)
            self._blocks.append((first, block))
            self.available += len(block)
            while self.available > self.capacity:
                self.overwritten += len(self._take(self.available - self.capacity))
            self._arrived.notify()

    def read(self, max_frames: int | None = None) -> tuple[int, NDArray]:
        """Oldest contiguous block, from the reading thread: index of its first sample and samples (n, channels).

        A block ends before a gap. Does not wait: n = 0 when there are no samples.
        """
        parts = [self._empty]
        with self._arrived:
            begin = end = self._blocks[0][0] if self._blocks else self._next
            left = self.available if max_frames is None else max_frames
            while left and self._blocks and self._blocks[0][0] == end:
                parts.append(self._take(left))
                end, left = end + len(parts[-1]), left - len(parts[-1])
        return begin, np.concatenate(parts)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait, in the reading thread, for samples after the last `read`; False after `timeout` seconds."""
        with self._arrived:
            return self._arrived.wait_for(lambda: self.available > 0, timeout)

    def _take(self, most: int) -> NDArray:
        """Remove up to `most` frames of the oldest block, and return them."""
        first, block = self._blocks.popleft()
        if len(block) > most:
            self._blocks.appendleft((first + most, block[most:]))
        self.available -= min(len(block), most)
        return block[:most]
