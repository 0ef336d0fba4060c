"""Notches at the harmonics of the rig's own rotors, and estimation of their blade-pass frequencies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, median_filter

# Half-width of a notch: the main lobe of the taper, plus a share of the frequency for errors and changes of the speed.
NOTCH_HZ = 4.0
NOTCH_SHARE = 0.004
# Blade-pass frequencies of small multirotors.
RANGE_HZ = (60.0, 400.0)
STEP_HZ = 0.05
LINE_OVER_FLOOR_HZ = 50.0


def notch(frequencies: NDArray, blade_pass_hz: ArrayLike) -> NDArray:
    """Which bins (k,) at frequencies (k,) in Hz are free of harmonics of the blade-pass frequencies (r,) in Hz.

    Parameters:
        frequencies (k,) (Hz): frequencies of the bins.
        blade_pass_hz (r,) (Hz): blade-pass frequencies; 0 for a rotor that stands still.
    """
    free = np.ones(len(frequencies), bool)
    for fundamental in np.asarray(blade_pass_hz, dtype=float):
        if fundamental > 0.0:
            order = np.maximum(1.0, np.round(frequencies / fundamental))
            distance = np.abs(frequencies - order * fundamental)
            free &= distance > NOTCH_HZ + NOTCH_SHARE * frequencies
    return free


def find_blade_pass(frequencies: NDArray, power: NDArray, count: int) -> NDArray:
    """Blade-pass frequencies (count,) in Hz of the strongest rotors in a power spectrum.

    Each is the fundamental whose harmonics exceed the noise floor most, summed over their logarithms; its bins are notched
    before the search for the next. Meant for the rig's own rotors, which are closer than any target and thus louder.

    Parameters:
        frequencies (k,) (Hz): evenly spaced frequencies of the bins.
        power (k,): power of the bins.
        count: number of rotors.
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
        # division by the root of the number of harmonics prevents that half of the fundamental has the higher score
        score = np.sum(prominence[bins] * inside, axis=1) / np.sqrt(inside.sum(axis=1))
        found.append(candidates[np.argmax(score)])
        prominence = prominence * notch(frequencies, found[-1:])
    return np.array(found)
