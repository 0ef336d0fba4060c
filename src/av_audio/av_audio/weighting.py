"""How much each frequency of a cross-spectrum says about the delay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

# Widths of the running means over frequency in Hz: of the signal's power, of the coherence, and of the noise, which is
# smooth. Narrower ones follow a rotor's lines, but also what is chance in them.
LINE_HZ = 40.0
COHERENCE_HZ = 40.0
NOISE_HZ = 260.0
# Nothing outdoors is more alike at two microphones than this leaves.
MISMATCH = 0.002
# Share of a source's power that arrives by other ways than the straight one, everywhere and, more, where microphones
# hear the diffuse sound of a room alike.
REFLECTED = 0.1
DIFFUSE = 1.0
# Where so much less is incoherent than coherent, there is no room.
MOST_REFLECTED = 5.0
# The band-pass counts where a source stands less than this over the noise.
WEAK = 1.3


@dataclass(frozen=True)
class Band:
    """What weightings may know of the bins: their distance, the band-pass, and how alike diffuse sound is in a pair.

    response: |H|^2 of the band-pass (k,); diffuse: squared coherence of diffuse sound (p, k).
    """

    bin_hz: float
    response: NDArray
    diffuse: NDArray

    @classmethod
    def of(cls, frequencies: NDArray, response: NDArray, distances: NDArray, speed_of_sound: float) -> Band:
        """For bins at `frequencies` (k,) and pairs of microphones `distances` (p,) in m apart (Cook et al., 1955)."""
        coherence = np.sinc(2.0 * np.outer(distances, frequencies) / speed_of_sound)
        return cls(float(frequencies[1] - frequencies[0]), response.astype(np.float32), (coherence**2).astype(np.float32))


Weighting = Callable[[NDArray, NDArray, Band], NDArray]


def cross_spectra(spectra: NDArray, pairs: NDArray) -> NDArray:
    """Cross-spectra X_i conj(X_j) (p, k) of spectra (m, k) for pairs (p, 2)."""
    return spectra[pairs[:, 0]] * spectra[pairs[:, 1]].conj()


def phat(cross: NDArray, power: NDArray, band: Band) -> NDArray:
    """Phase transform: every bin of the band counts alike (Knapp and Carter, 1976). Real weights (p, k)."""
    magnitude = np.abs(cross)
    return band.response / np.maximum(magnitude, np.finfo(magnitude.dtype).tiny)


def plain(cross: NDArray, power: NDArray, band: Band) -> NDArray:
    """No weighting: the plain cross-correlation, best in white noise without reflections. Real weights (p, k)."""
    return np.broadcast_to(band.response / max(float(power.mean()), np.finfo(power.dtype).tiny), power.shape)


def maximum_likelihood(cross: NDArray, power: NDArray, band: Band) -> NDArray:
    """Weights (p, k) of the maximum-likelihood delay for a source in noise and reflections.

    For source power S and noise N the likelihood's weight of a cross-spectrum is S / (N (2 S + N)) (Knapp and Carter,
    1976, eq. 51). Reflections are noise that follows the source, so N becomes N + r S (Zhang, Florencio and Zhang,
    ICASSP 2008): lines far above the noise then count alike, as with PHAT, and empty bins hardly count. r is larger at
    low frequencies, where the diffuse sound of a room is coherent and passes for a source in front, and r S at most a few
    N, as reflections make sound incoherent. S and N come from the window itself: what is incoherent between the
    microphones is noise. Where S stands above N the likelihood does not care what the band-pass lets through; where it
    does not, the band-pass keeps noise at the band's edges out.

    cross: (p, k), power: sqrt(P_i P_j) (p, k) of the same pairs.
    """
    noise = noise_power(cross, power, band.bin_hz)
    source = np.maximum(_smooth(power, LINE_HZ / band.bin_hz) - noise, 0.05 * noise)
    disturbed = noise + np.minimum((REFLECTED + DIFFUSE * band.diffuse) * source, MOST_REFLECTED * noise)
    strength = np.square(np.square(np.minimum(source / (WEAK * noise), 100.0)))
    passed = 1.0 - (1.0 - band.response) / (1.0 + strength)
    return passed * source / (disturbed * (2.0 * source + disturbed))


def noise_power(cross: NDArray, power: NDArray, bin_hz: float) -> NDArray:
    """Power (p, k) of what is incoherent between the microphones of each pair."""
    smooth_power, real, imaginary = _smooth(np.stack([power, cross.real, cross.imag]), COHERENCE_HZ / bin_hz)
    coherent = np.sqrt(real**2 + imaginary**2)
    noise = _smooth(np.maximum(smooth_power - coherent, MISMATCH * smooth_power), NOISE_HZ / bin_hz)
    floor = 1e-9 * power.mean(axis=-1, keepdims=True) + np.finfo(power.dtype).tiny
    return np.maximum(noise, floor)


def _smooth(values: NDArray, bins: float) -> NDArray:
    return uniform_filter1d(values, max(1, round(bins)), axis=-1, mode='nearest')
