"""Notches at the harmonics of the rig's own rotors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Half-width of a notch: the main lobe of the taper, plus a share of the frequency for errors and changes of the speed.
NOTCH_HZ = 4.0
NOTCH_SHARE = 0.004

ALIKE_HZ = 250.0  # within this width the sound between lines is alike


def without_lines(spectra: NDArray, frequencies: NDArray, blade_pass_hz: NDArray) -> NDArray:
    """Spectra (m, k), 0 in the notches where lines are louder than what is beside them.

    Notches of four rotors cover three fifths of the bins above 2 kHz. Lines that jitter are no louder there than the hiss of
    the rotors, and a target is in these bins, too.

    Parameters:
        spectra (m, k): of a window.
        frequencies (k,) (Hz): frequencies of the bins.
        blade_pass_hz (r,) (Hz): blade-pass frequencies; 0 for a rotor that stands still.
    """
    if not np.any(blade_pass_hz):
        return spectra
    power = np.sum(np.abs(spectra) ** 2, axis=0)
    parts = np.array_split(power, max(1, round((frequencies[-1] - frequencies[0]) / ALIKE_HZ)))
    beside = np.concatenate([np.full(len(part), np.median(part)) for part in parts])
    return np.asarray(spectra * (notch(frequencies, blade_pass_hz) | (power < 2.0 * beside)))


def notch(frequencies: NDArray, blade_pass_hz: ArrayLike) -> NDArray:
    """Which bins (k,) at frequencies (k,) in Hz are free of harmonics of the blade-pass frequencies (r,) in Hz.

    Parameters:
        frequencies (k,) (Hz): frequencies of the bins.
        blade_pass_hz (r,) (Hz): blade-pass frequencies; about 0 for a rotor that stands still.
    """
    free = np.ones(len(frequencies), bool)
    for fundamental in np.asarray(blade_pass_hz, dtype=float):
        if fundamental > 2.0 * NOTCH_HZ:  # lines closer than notches are wide leave nothing, and such a rotor is not heard
            order = np.maximum(1.0, np.round(frequencies / fundamental))
            distance = np.abs(frequencies - order * fundamental)
            free &= distance > NOTCH_HZ + NOTCH_SHARE * frequencies
    return free
