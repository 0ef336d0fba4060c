"""Check whether an audio stream carries directions: a stereo mix has level differences but no time differences."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

_BLOCK_S = 0.1            # s, duration of the samples of one delay measurement
_BLOCKS = 100             # number of newest delays that are evaluated
_LOUD = 1e-4              # standard deviation of the samples below which no delay is measured
_LEAST_SPREAD_S = 1e-6    # s, minimum spread of the delays; a mix has none, a source straight ahead has some


class DirectionCheck:
    """Measures the delay between the first two channels every 0.1 s, from the peak of their cross-correlation.

    Parameters:
        sample_rate (Hz): sample rate of the stream.
        largest_delay_s (s): limit of the searched delays, in both directions.
    """

    def __init__(self, sample_rate: int, largest_delay_s: float = 2e-3):
        self._block = int(_BLOCK_S * sample_rate)
        self._rate, self._reach = sample_rate, max(int(largest_delay_s * sample_rate), 2)
        self._collected: list[NDArray] = []
        self._delays: deque[float] = deque(maxlen=_BLOCKS)

    def add(self, samples: NDArray) -> None:
        """Process consecutive samples (n, channels), full scale 1."""
        if samples.shape[1] < 2:
            return
        self._collected.append(np.asarray(samples[:, :2], float))
        if sum(map(len, self._collected)) < self._block:
            return
        block = np.concatenate(self._collected)
        self._collected.clear()
        if block.std() > _LOUD:
            self._delays.append(self._delay(block - block.mean(axis=0)))

    @property
    def spread_s(self) -> float:
        """Spread of the delays (s, 5th to 95th percentile), NaN for fewer than 20 delays."""
        if len(self._delays) < 20:
            return float('nan')
        return float(np.diff(np.percentile(self._delays, [5, 95]))[0])

    @property
    def problem(self) -> str:
        """Reason why no direction can be estimated from this stream, empty if none is known."""
        if len(self._delays) < _BLOCKS or self.spread_s >= _LEAST_SPREAD_S:
            return ''
        if abs(np.median(self._delays)) < _LEAST_SPREAD_S:
            return ('the channels have no time differences: this looks like a listener mix (stereo) '
                    'that carries no direction')
        return ''

    def _delay(self, block: NDArray) -> float:
        spectrum = np.fft.rfft(block, 2 * len(block), axis=0)
        cross = spectrum[:, 1] * spectrum[:, 0].conj()
        around = np.fft.irfft(cross)[np.arange(-self._reach, self._reach + 1)]
        peak = int(np.argmax(around[1:-1])) + 1
        before, at, after = around[peak - 1:peak + 2]
        curve = before - 2 * at + after
        fraction = 0.5 * (before - after) / curve if curve < 0 else 0.0
        return (peak - self._reach + fraction) / self._rate
