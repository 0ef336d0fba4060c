"""The rig's own rotors: which bins of a spectrum their harmonics fill."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, median_filter

# Half-width of a notch: the taper's main lobe, and how far a speed may be off or wander within a window.
NOTCH_HZ = 4.0
NOTCH_SHARE = 0.004
# Blade-pass frequencies of small multirotors.
RANGE_HZ = (60.0, 400.0)
STEP_HZ = 0.05
LINE_OVER_FLOOR_HZ = 50.0


def notch(frequencies: NDArray, blade_pass_hz: ArrayLike) -> NDArray:
    """Which bins (k,) at frequencies (k,) are free of the harmonics of the blade-pass frequencies (r,)."""
    free = np.ones(len(frequencies), bool)
    for fundamental in np.asarray(blade_pass_hz, dtype=float):
        if fundamental > 0.0:
            order = np.maximum(1.0, np.round(frequencies / fundamental))
            distance = np.abs(frequencies - order * fundamental)
            free &= distance > NOTCH_HZ + NOTCH_SHARE * frequencies
    return free


def find_blade_pass(frequencies: NDArray, power: NDArray, count: int) -> NDArray:
    """Blade-pass frequencies (count,) of the strongest rotors in a power spectrum (k,).

    Each is the fundamental whose harmonics stand out most from the floor, summed in dB per harmonic; the bins of one
    are left out before the next is looked for. For own rotors, which are nearer than any target and so the loudest.
    """
    bin_hz = frequencies[1] - frequencies[0]
    floor = median_filter(power, 2 * round(LINE_OVER_FLOOR_HZ / bin_hz) + 1, mode='nearest')
    prominence = np.log(np.maximum(power, 1e-30) / np.maximum(floor, 1e-30))
    prominence = np.clip(maximum_filter1d(prominence, 3), 0.0, None)
    candidates = np.arange(RANGE_HZ[0], RANGE_HZ[1], STEP_HZ)
    orders = np.arange(1, 25)
    bins = np.round((np.outer(candidates, orders) - frequencies[0]) / bin_hz).astype(int)
    inside = (bins >= 0) & (bins < len(frequencies))
    bins = np.clip(bins, 0, len(frequencies) - 1)
    found = []
    for _ in range(count):
        # the root of the number of harmonics keeps half of a fundamental from winning over it
        score = np.sum(prominence[bins] * inside, axis=1) / np.sqrt(inside.sum(axis=1))
        found.append(candidates[np.argmax(score)])
        prominence = prominence * notch(frequencies, found[-1:])
    return np.array(found)
