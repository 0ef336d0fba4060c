"""What rendered sounds are made of: phases, harmonics, noise in bands, slow changes."""

from __future__ import annotations

import numpy as np
from material import RATE
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

SECONDS = 2.5
COUNT = int(SECONDS * RATE)  # samples of a rendered sound
Samples = NDArray[np.float64]


def times() -> Samples:
    """Times (n,) in s of the samples."""
    return np.arange(COUNT) / RATE


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def harmonics(turns: Samples, orders: NDArray, level: NDArray, rng: np.random.Generator) -> Samples:
    """Sum of sines at the orders of turns (n,) whose frequency stays below half the rate."""
    speed = np.gradient(turns) * RATE
    total = np.zeros(len(turns))
    for order, amplitude in zip(orders, level, strict=True):
        audible = order * speed < 0.48 * RATE
        if audible.any():
            total += amplitude * audible * np.sin(2.0 * np.pi * (order * turns + rng.random()))
    return total


def phase(frequency: Samples) -> Samples:
    """Turns (n,) of a frequency (n,) in Hz."""
    return np.cumsum(frequency) / RATE


def wandering(rng: np.random.Generator, depth: float, rate_hz: float) -> Samples:
    """A factor (n,) around 1 that varies slowly."""
    points = rng.standard_normal(int(SECONDS * rate_hz) + 3)
    at = np.linspace(0.0, len(points) - 1.001, COUNT)
    return np.clip(1.0 + depth * np.interp(at, np.arange(len(points)), points), 0.2, 3.0)


def band(rng: np.random.Generator, low: float, high: float) -> Samples:
    """Noise (n,) of unit power in a band (Hz)."""
    noise = sosfilt(butter(2, [low, high], 'bandpass', fs=RATE, output='sos'), rng.standard_normal(COUNT))
    return np.asarray(noise / np.std(noise))
