"""Notches at the harmonics of the rig's own rotors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Half-width of a notch: the main lobe of the taper, plus a share of the frequency for errors and changes of the speed.
NOTCH_HZ = 4.0
NOTCH_SHARE = 0.004


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
