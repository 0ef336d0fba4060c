"""Sound absorption of surfaces in octave bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BANDS_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)

Absorption = Sequence[float]  # absorption coefficients (0 to 1, by energy): one for all bands, or one for each of BANDS_HZ


def reflection_factor(absorption: Absorption, frequency_hz: NDArray) -> NDArray:
    """Reflection factor of the amplitude, sqrt(1 - absorption), interpolated between bands on a logarithmic axis.

    Raises ValueError for coefficients outside 0 to 1 or a wrong number of bands.

    Parameters:
        absorption: absorption coefficients.
        frequency_hz (Hz): frequencies, of any shape.
    """
    values = np.atleast_1d(np.asarray(absorption, float))
    if values.shape not in ((1,), (len(BANDS_HZ),)) or values.min() < 0.0 or values.max() > 1.0:
        raise ValueError(f'absorption is {absorption}, expected one number from 0 to 1, or one for each of {BANDS_HZ} Hz')
    if len(values) == 1:
        return np.full(np.shape(frequency_hz), np.sqrt(1.0 - values[0]))
    place = np.log2(np.maximum(frequency_hz, 1.0))
    return np.sqrt(1.0 - np.interp(place, np.log2(BANDS_HZ), values))
