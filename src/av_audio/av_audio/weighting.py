"""How much each frequency of a cross-spectrum says about the delay."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

# Widths of the running means over frequency in Hz: of the signal's power (a rotor's line), of the coherence, and of
# the noise, which is smooth.
LINE_HZ = 20.0
COHERENCE_HZ = 40.0
NOISE_HZ = 260.0
# Share of a source's power that arrives by other ways than the straight one.
REFLECTED = 0.1

Weighting = Callable[[NDArray, NDArray, float], NDArray]


def cross_spectra(spectra: NDArray, pairs: NDArray) -> NDArray:
    """Cross-spectra X_i conj(X_j) (p, k) of spectra (m, k) for pairs (p, 2)."""
    return spectra[pairs[:, 0]] * spectra[pairs[:, 1]].conj()


def phat(cross: NDArray, power: NDArray, bin_hz: float) -> NDArray:
    """Phase transform: every bin counts alike (Knapp and Carter, 1976). Real weights (p, k)."""
    magnitude = np.abs(cross)
    return 1.0 / np.maximum(magnitude, np.finfo(magnitude.dtype).tiny)


def plain(cross: NDArray, power: NDArray, bin_hz: float) -> NDArray:
    """No weighting: the plain cross-correlation, best in white noise without reflections."""
    return np.full_like(power, 1.0 / max(float(power.mean()), np.finfo(power.dtype).tiny))


def maximum_likelihood(cross: NDArray, power: NDArray, bin_hz: float) -> NDArray:
    """Weights (p, k) of the maximum-likelihood delay for a source in noise and reflections.

    For source power S and noise N the likelihood's weight of a cross-spectrum is S / (N (2 S + N)) (Knapp and Carter,
    1976, eq. 51). Reflections are noise that follows the source, so N becomes N + r S (Zhang, Florencio and Zhang,
    ICASSP 2008): lines far above the noise then count alike, as with PHAT, and empty bins hardly count. S and N come
    from the window itself: what is incoherent between the microphones is noise.

    cross: (p, k), power: sqrt(P_i P_j) (p, k) of the same pairs, bin_hz: distance of two bins.
    """
    noise = noise_power(cross, power, bin_hz)
    source = np.maximum(_smooth(power, LINE_HZ / bin_hz) - noise, 0.05 * noise)
    disturbed = noise + REFLECTED * source
    return source / (disturbed * (2.0 * source + disturbed))


def noise_power(cross: NDArray, power: NDArray, bin_hz: float) -> NDArray:
    """Power (p, k) of what is incoherent between the microphones of each pair."""
    smooth_power, real, imaginary = _smooth(np.stack([power, cross.real, cross.imag]), COHERENCE_HZ / bin_hz)
    coherent = np.sqrt(real**2 + imaginary**2)
    noise = _smooth(np.maximum(smooth_power - coherent, 0.0), NOISE_HZ / bin_hz)
    floor = 1e-9 * power.mean(axis=-1, keepdims=True) + np.finfo(power.dtype).tiny
    return np.maximum(noise, floor)


def _smooth(values: NDArray, bins: float) -> NDArray:
    return uniform_filter1d(values, max(1, round(bins)), axis=-1, mode='nearest')
