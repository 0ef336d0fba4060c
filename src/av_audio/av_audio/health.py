"""What is wrong with the sound of a microphone array, told from the sound itself."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from av_audio.localizer import FULL_SCALE, DoaEstimate

DEAD_DBFS = -100.0
# A channel this much quieter than the loudest is as good as dead beside it.
QUIET_DB = 40.0
CLIPPED_SHARE = 1e-3
OFFSET = 0.05
# An angle cosine that jumps from one steady value to its negative, with nothing in between, belongs to no moving source.
LEAST_SWAP = 0.3
SWAP_TOLERANCE = 0.05
SWAP_WITHIN_S = 2.5
STEADY = 3
CONFIDENT = 0.9


class ChannelHealth:
    """Watches blocks of samples and says which channels clip, are dead, have an offset or are copies of each other.

    Figures cover the time since the last `problems`, so that a fault disappears from them when it is mended.
    """

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._reset()

    def update(self, samples: NDArray) -> None:
        """Take note of samples (n, m)."""
        if not len(samples):
            return
        self._count += len(samples)
        self._sum += samples.sum(axis=0, dtype=float)
        self._squares += np.einsum('nm,nm->m', samples, samples, dtype=float)
        self._clipped += np.count_nonzero(np.abs(samples) >= FULL_SCALE, axis=0)
        self._differs |= np.any(samples != samples[:, :1], axis=0)

    def levels_dbfs(self) -> NDArray:
        """Level (m,) of each channel without its offset in dB relative to full scale, -inf for none."""
        if not self._count:
            return np.full(self._channels, -np.inf)
        power = self._squares / self._count - (self._sum / self._count) ** 2
        with np.errstate(divide='ignore'):
            return 10.0 * np.log10(np.maximum(power, 0.0))

    def problems(self) -> list[str]:
        """What was wrong since the last call, in words; begins anew."""
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
    """Notices that two channels changed places while the stream ran, as a lost sample of an interleaved stream does.

    That swap mirrors the direction from one moment to the next, while a source, or a rig that turns, passes through the
    directions between. (Channels that were swapped from the beginning cannot be told from a source on the other side.)
    """

    def __init__(self) -> None:
        self._history: deque[tuple[float, float]] = deque()

    def update(self, estimate: DoaEstimate) -> bool:
        """Whether the estimates of a pair have stayed at one direction and now stay at its mirror image."""
        if not len(estimate.confidence) or estimate.confidence[0] < CONFIDENT:
            return False
        while self._history and self._history[0][0] < estimate.time - SWAP_WITHIN_S:
            self._history.popleft()
        self._history.append((estimate.time, float(estimate.q[0])))
        cosines = np.array([cosine for _, cosine in self._history])
        before, after = np.abs(cosines + cosines[-1]) < SWAP_TOLERANCE, np.abs(cosines - cosines[-1]) < SWAP_TOLERANCE
        swapped = bool(abs(cosines[-1]) > LEAST_SWAP and np.all(before | after)
                       and before[:STEADY].sum() == STEADY and after[-STEADY:].sum() == STEADY)
        if swapped:
            self._history.clear()
        return swapped
