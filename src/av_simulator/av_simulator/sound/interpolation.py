"""Interpolation of sampled signals by a windowed sinc (Laakso et al., Splitting the unit delay, 1996, section 3)."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

TAPS = 32
BEFORE = TAPS // 2 - 1  # number of taps before the sample just below the interpolated place
AFTER = TAPS // 2       # number of taps after it
_PHASES = 4096  # number of fractional delays; the nearest one is used, with an error up to 1/8192 sample
_KAISER_BETA = 8.0
_PIECE = 4096  # number of places that are processed at a time, so that their windows fit into the processor's cache


def _table() -> NDArray:
    """Kernels (phases + 1, TAPS), one for each fraction of a sample, with unit gain at zero frequency."""
    fraction = np.arange(_PHASES + 1)[:, None] / _PHASES
    place = np.arange(-BEFORE, AFTER + 1) - fraction
    window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1.0 - (place / (TAPS / 2)) ** 2, 0.0, None)))
    kernels = np.sinc(place) * window
    return kernels / kernels.sum(axis=1, keepdims=True)


_KERNELS = _table()


def kernels(fractions: NDArray) -> NDArray:
    """Weights (..., TAPS) on samples -BEFORE ... AFTER for a unit pulse at `fractions` (...,) of a sample, 0 to 1."""
    return _KERNELS[np.rint(np.asarray(fractions) * _PHASES).astype(int)]


def interpolate(signals: NDArray, rows: NDArray, places: NDArray) -> NDArray:
    """Interpolated values, in the shape of `places`.

    The response is flat up to 20 kHz at 48 kHz; the error is -94 dB at 1 kHz and -80 dB at 10 kHz. Raises ValueError unless
    BEFORE <= place < length - AFTER - 1.

    Parameters:
        signals ((count, length)): sampled signals.
        rows: index of the signal for each place, in the shape of `places`.
        places (samples): positions from the beginning of the signal, of any shape.
    """
    length = signals.shape[1]
    if places.size and not (places.min() >= BEFORE and places.max() < length - AFTER - 1):
        raise ValueError(f'places are {places.min():.1f} to {places.max():.1f}, expected {BEFORE} to {length - AFTER - 1}')
    steps = np.rint(places * _PHASES).astype(np.int64).ravel()
    below = steps // _PHASES
    phases = steps - below * _PHASES
    first = (rows * length).ravel() + below - BEFORE
    windows = sliding_window_view(np.ascontiguousarray(signals).ravel(), TAPS)
    values = np.empty(len(first))
    for piece in range(0, len(first), _PIECE):
        part = slice(piece, piece + _PIECE)
        values[part] = np.einsum('nt,nt->n', windows[first[part]], _KERNELS[phases[part]])
    return values.reshape(places.shape)
