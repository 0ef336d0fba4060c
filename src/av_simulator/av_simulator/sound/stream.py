"""Endless signals that can be read at any sample index, in any order, with the same result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

CHUNK = 4096
SIGNAL_CHUNKS = 64  # kept of a signal, 5 s at 48 kHz: more than sound needs from 1.5 km


class Stream:
    """A signal made in chunks of CHUNK samples that begin at multiples of CHUNK, before sample 0 as well.

    A chunk depends on its index alone, so the samples do not depend on the order of reading.

    Parameters:
        make: samples index * CHUNK ... (index + 1) * CHUNK - 1 of an index, along the last axis.
        kept: chunks that are kept rather than made again.
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
    """Random numbers that belong to one chunk of the stream named by `key`."""
    return np.random.default_rng([*key, chunk + 2**40])


def white_noise(key: Sequence[int], channels: int | None = None) -> Stream:
    """Gaussian noise of variance 1: (CHUNK,), or (channels, CHUNK) independent between channels."""
    shape = (CHUNK,) if channels is None else (channels, CHUNK)
    return Stream(lambda index: generator(key, index).standard_normal(shape))


def filtered(source: Stream, response: NDArray) -> Stream:
    """The stream through a finite impulse response of odd length whose middle tap is time zero."""
    half = len(response) // 2

    def make(index: int) -> NDArray:
        around = source.read(index * CHUNK - half, (index + 1) * CHUNK + half)
        taps = response.reshape((1,) * (around.ndim - 1) + (-1,))
        return oaconvolve(around, taps, mode='valid', axes=-1)

    return Stream(make)


def band_power(stream: Stream, sample_rate: float, band_hz: tuple[float, float], duration_s: float = 4.0) -> float:
    """Mean power of the first seconds of a stream inside a band, averaged over channels, from the periodogram (Parseval)."""
    samples = stream.read(0, int(duration_s * sample_rate))
    spectrum = np.abs(np.fft.rfft(samples)) ** 2
    frequencies = np.fft.rfftfreq(samples.shape[-1], 1.0 / sample_rate)
    inside = (frequencies >= band_hz[0]) & (frequencies < band_hz[1])
    return float(2.0 * spectrum[..., inside].sum(axis=-1).mean() / samples.shape[-1] ** 2)
