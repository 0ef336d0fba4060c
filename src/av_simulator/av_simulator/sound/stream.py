"""Signals of unlimited length with random access, whose samples do not depend on the order of access; levels.

All signals of this package are sound pressures in Pa.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

CHUNK = 4096        # samples
SIGNAL_CHUNKS = 64  # number of cached chunks of a signal: 5 s at 48 kHz, more than the delay over 1.5 km
LEVEL_S = 4.0       # of the start of a signal, from which its level is taken
REFERENCE_PA = 20e-6  # of sound pressure levels
_TERMS = 24           # sines of a slow random variation


def db_to_ratio(level_db: float) -> float:
    """Amplitude ratio of a level in dB."""
    return 10.0 ** (level_db / 20.0)


def spl_to_pascal(level_db_spl: float) -> float:
    """Root mean square pressure (Pa) of a sound pressure level (dB)."""
    return REFERENCE_PA * db_to_ratio(level_db_spl)


class Stream:
    """A signal computed in chunks of CHUNK samples that start at multiples of CHUNK, which may be negative.

    A chunk depends only on its index, so that the samples do not depend on the order of access.

    Parameters:
        make: function from an index to the samples index * CHUNK ... (index + 1) * CHUNK - 1, along the last axis.
        kept: number of cached chunks.
    """

    def __init__(self, make: Callable[[int], NDArray], kept: int = 4):
        self._chunk = lru_cache(maxsize=kept)(make)

    def read(self, start: int, stop: int) -> NDArray:
        """Samples start ... stop - 1 along the last axis."""
        first = start // CHUNK
        chunks = [self._chunk(index) for index in range(first, (stop - 1) // CHUNK + 1)]
        joined = chunks[0] if len(chunks) == 1 else np.concatenate(chunks, axis=-1)
        return joined[..., start - first * CHUNK:stop - first * CHUNK]


def generator(key: Sequence[int], chunk: int) -> np.random.Generator:
    """Random number generator for one chunk of the stream with the seed `key`."""
    return np.random.default_rng([*key, chunk + 2**40])


def white_noise(key: Sequence[int], channels: int | None = None) -> Stream:
    """Gaussian noise of variance 1, (CHUNK,) or (channels, CHUNK) with independent channels, from the seed `key`."""
    shape = (CHUNK,) if channels is None else (channels, CHUNK)
    return Stream(lambda index: generator(key, index).standard_normal(shape))


def filtered(source: Stream, response: NDArray) -> Stream:
    """The stream `source` filtered by a finite impulse response of odd length, whose middle tap has no delay."""
    half = len(response) // 2

    def make(index: int) -> NDArray:
        around = source.read(index * CHUNK - half, (index + 1) * CHUNK + half)
        taps = response.reshape((1,) * (around.ndim - 1) + (-1,))
        return oaconvolve(around, taps, mode='valid', axes=-1)

    return Stream(make)


def band_power(samples: NDArray, sample_rate: float, band_hz: tuple[float, float]) -> float:
    """Mean power within a band, averaged over channels, from the periodogram (Parseval).

    Parameters:
        samples ((..., n)): the sound.
        sample_rate (Hz): sample rate.
        band_hz (Hz): lower and upper end of the band.
    """
    spectrum = np.abs(np.fft.rfft(samples)) ** 2
    frequencies = np.fft.rfftfreq(samples.shape[-1], 1.0 / sample_rate)
    inside = (frequencies >= band_hz[0]) & (frequencies < band_hz[1])
    return float(2.0 * spectrum[..., inside].sum(axis=-1).mean() / samples.shape[-1] ** 2)


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
