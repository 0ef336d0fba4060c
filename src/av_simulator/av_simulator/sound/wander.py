"""Slow random variation of rotor speeds and of noise levels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_TERMS = 24


class Wander:
    """A nearly Gaussian random process of mean 0 and variance 1, which can be evaluated at any time.

    It is a sum of sines (Shinozuka 1972). Their frequencies range from 0.04 % of `fastest_hz` to `fastest_hz`, with more low
    than high ones.

    Parameters:
        key: seed.
        fastest_hz (Hz): highest frequency.
        channels: number of independent processes.
    """

    def __init__(self, key: Sequence[int], fastest_hz: float, channels: int = 1):
        random = np.random.default_rng(key)
        self._rate = 2 * np.pi * fastest_hz * random.uniform(0.02, 1.0, (_TERMS, 1, channels)) ** 2
        self._phase = random.uniform(0.0, 2 * np.pi, (_TERMS, 1, channels))

    def __call__(self, times: NDArray) -> NDArray:
        """Values (k, channels) at times (s, (k,))."""
        return np.sqrt(2.0 / _TERMS) * np.sin(self._rate * times[:, None] + self._phase).sum(axis=0)

    def integral(self, times: NDArray) -> NDArray:
        """Integrals (s, (k, channels)) from any fixed instant to times (s, (k,))."""
        return -np.sqrt(2.0 / _TERMS) * (np.cos(self._rate * times[:, None] + self._phase) / self._rate).sum(axis=0)
