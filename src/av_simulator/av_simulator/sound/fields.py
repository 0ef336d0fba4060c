"""Noise at several microphones with given spectrum and mutual coherence (Habets, Cohen and Gannot 2008)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from av_simulator.sound.stream import CHUNK, Stream, generator

# Vectors (m, (m, m, 3)) from microphone i to j, and frequencies (Hz, (F,)) -> Hermitian coherence matrices (F, m, m).
Coherence = Callable[[NDArray, NDArray], NDArray]


def field_noise(key: Sequence[int], sample_rate: int, layout: NDArray, density: Callable[[NDArray], NDArray],
                coherence: Coherence) -> Stream:
    """Noise (m, CHUNK) of mean power 1.

    Segments of two chunks with random spectra overlap by half under a sine window, which keeps the power constant.

    Parameters:
        key: seed.
        sample_rate (Hz): sample rate.
        layout (m, (m, 3)): positions of the microphones.
        density: function from frequencies (Hz, (F,)) to power spectral densities (F,) in any unit.
        coherence: coherence between the microphones.
    """
    size = 2 * CHUNK
    frequency = np.fft.rfftfreq(size, 1.0 / sample_rate)
    power = density(np.maximum(frequency, frequency[1])) * (frequency > 0.0)
    matrix = coherence(layout[None, :] - layout[:, None], frequency)
    values, vectors = np.linalg.eigh(matrix)
    amplitude = np.sqrt(power / power.sum() / 2.0) * size
    mix = vectors * np.sqrt(np.maximum(values, 0.0))[:, None] * amplitude[:, None, None]
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size)

    @lru_cache(maxsize=4)
    def piece(index: int) -> NDArray:
        parts = generator(key, index).standard_normal((2, len(frequency), len(layout)))
        spectrum = np.einsum('fij,fj->if', mix, (parts[0] + 1j * parts[1]) / np.sqrt(2.0))
        return np.fft.irfft(spectrum, size) * window

    return Stream(lambda index: piece(index)[:, CHUNK:] + piece(index + 1)[:, :CHUNK])


def diffuse(speed_of_sound: float) -> Coherence:
    """Coherence of a diffuse field, isotropic in three dimensions: sin(kd) / kd (Cook et al. 1955)."""
    return lambda apart, frequency: np.sinc(2.0 * _turns(np.linalg.norm(apart, axis=-1), frequency, speed_of_sound)) + 0j


def horizontal(speed_of_sound: float) -> Coherence:
    """Coherence of a field that is isotropic in the horizontal plane: J0(kd)."""
    def coherence(apart: NDArray, frequency: NDArray) -> NDArray:
        return j0(2.0 * np.pi * _turns(np.hypot(apart[..., 0], apart[..., 1]), frequency, speed_of_sound)) + 0j

    return coherence


def corcos(velocity: Sequence[float]) -> Coherence:
    """Coherence of turbulence that is convected past the microphones by a wind (m/s, (x, y, z)) (Corcos 1963).

    The coherence decays exponentially with the phase along and across the wind, and its phase is the delay of convection.
    Eddies travel at 0.7 of the wind's speed.
    """
    speed = float(np.linalg.norm(velocity))
    way = np.asarray(velocity, float) / speed

    def coherence(apart: NDArray, frequency: NDArray) -> NDArray:
        along = apart @ way
        across = np.linalg.norm(apart - along[..., None] * way, axis=-1)
        radians = 2.0 * np.pi * frequency[:, None, None] / (0.7 * speed)
        return np.exp(-radians * (0.116 * np.abs(along) + 0.7 * across) + 1j * radians * along)

    return coherence


def _turns(distance: NDArray, frequency: NDArray, speed_of_sound: float) -> NDArray:
    """Distances (m, m) divided by the wavelengths at frequencies (F,): (F, m, m)."""
    return frequency[:, None, None] * distance / speed_of_sound
