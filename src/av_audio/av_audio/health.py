"""Faults of the channels of a microphone array, detected in their samples."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:    # what computes them takes a while to import
    from av_audio.localizer import DoaEstimate

FULL_SCALE = 0.999    # amplitude from which a sample is clipped
DEAD_DBFS = -100.0
# A channel this much quieter than the loudest one is reported.
QUIET_DB = 40.0
CLIPPED_SHARE = 1e-3
OFFSET = 0.05
# A cosine that jumps from one steady value to its negative, without values between them, is not due to a moving source.
MIN_SWAP_COSINE = 0.3
SWAP_TOLERANCE = 0.05
SWAP_WITHIN_S = 2.5
STEADY = 3
CONFIDENT = 0.9


class ChannelHealth:
    """Detects channels that clip, are dead, have a constant offset or are copies of each other.

    The statistics cover the time since the last call of `problems`, so that a fault disappears once it is repaired.

    Parameters:
        channels: number of channels.
    """

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._reset()

    def update(self, samples: NDArray) -> None:
        """Add samples (n, channels) to the statistics."""
        if not len(samples):
            return
        self._count += len(samples)
        self._sum += samples.sum(axis=0, dtype=float)
        self._squares += np.einsum('nm,nm->m', samples, samples, dtype=float)
        self._clipped += np.count_nonzero(np.abs(samples) >= FULL_SCALE, axis=0)
        self._differs |= np.any(samples != samples[:, :1], axis=0)

    def levels_dbfs(self) -> NDArray:
        """Level (channels,) of each channel without its offset in dB relative to full scale, -inf for silence."""
        if not self._count:
            return np.full(self._channels, -np.inf)
        power = self._squares / self._count - (self._sum / self._count) ** 2
        with np.errstate(divide='ignore'):
            return 10.0 * np.log10(np.maximum(power, 0.0))

    def problems(self) -> list[str]:
        """Descriptions of the faults since the last call; resets the statistics."""
        if not self._count:
            return []
        levels = self.levels_dbfs()
        found = []
        for channel, level in enumerate(levels):
            offset = self._sum[channel] / self._count
            if level < DEAD_DBFS:
                found.append(f'channel {channel} is dead')
            elif level < levels.max() - QUIET_DB:
                found.append(f'channel {channel} is {levels.max() - level:.0f} dB quieter than the loudest')
            if self._clipped[channel] > CLIPPED_SHARE * self._count:
                found.append(f'channel {channel} clips in {100.0 * self._clipped[channel] / self._count:.1f} % of the samples')
            if abs(offset) > OFFSET:
                found.append(f'channel {channel} has a constant offset of {offset:+.2f} of full scale')
        copies = [channel for channel in range(1, self._channels) if not self._differs[channel] and levels[channel] > DEAD_DBFS]
        if copies:
            found.append(f'channels {", ".join(map(str, [0, *copies]))} are identical: one microphone, not an array')
        self._reset()
        return found

    def _reset(self) -> None:
        self._count = 0
        self._sum = np.zeros(self._channels)
        self._squares = np.zeros(self._channels)
        self._clipped = np.zeros(self._channels, int)
        self._differs = np.zeros(self._channels, bool)


class SwapDetector:
    """Detects that two channels change places in a running stream, for instance after a lost sample of interleaved data.

    The swap mirrors the direction suddenly, while a moving source or a rotating rig passes through the directions between.
    Channels that are swapped from the beginning cannot be distinguished from a source on the other side.
    """

    def __init__(self) -> None:
        self._history: deque[tuple[float, float]] = deque()

    def update(self, estimate: DoaEstimate) -> bool:
        """Whether the estimates of a pair were steady at one direction and are now steady at its mirror image."""
        if not len(estimate.confidence) or estimate.confidence[0] < CONFIDENT:
            return False
        while self._history and self._history[0][0] < estimate.time - SWAP_WITHIN_S:
            self._history.popleft()
        self._history.append((estimate.time, float(estimate.q[0])))
        cosines = np.array([cosine for _, cosine in self._history])
        before, after = np.abs(cosines + cosines[-1]) < SWAP_TOLERANCE, np.abs(cosines - cosines[-1]) < SWAP_TOLERANCE
        swapped = bool(abs(cosines[-1]) > MIN_SWAP_COSINE and np.all(before | after)
                       and before[:STEADY].sum() == STEADY and after[-STEADY:].sum() == STEADY)
        if swapped:
            self._history.clear()
        return swapped
