"""Slow random fluctuation, of rotor speeds and of noise levels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_TERMS = 24


class Wander:
    """A random process of mean 0 and variance 1, known at every instant without a history.

    It is a sum of sines (Shinozuka 1972) and nearly Gaussian. Its rates spread from 0.04 % of `fastest_hz` to
    `fastest_hz`, most of them low.

    Parameters:
        key: seed.
        fastest_hz (Hz): highest rate.
        channels: independent processes.
    """

    def __init__(self, key: Sequence[int], fastest_hz: float, channels: int = 1):
        random = np.random.default_rng(key)
        self._rate = 2 * np.pi * fastest_hz * random.uniform(0.02, 1.0, (_TERMS, 1, channels)) ** 2
        self._phase = random.uniform(0.0, 2 * np.pi, (_TERMS, 1, channels))

    def __call__(self, times: NDArray) -> NDArray:
        """Values (k, channels) at times (k,) in s."""
        return np.sqrt(2.0 / _TERMS) * np.sin(self._rate * times[:, None] + self._phase).sum(axis=0)
