"""Weights of the frequencies of a cross-spectrum in the estimation of a delay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.spectra import TINY

# Widths of the running means over frequency in Hz: of powers and coherence, and of the noise, which is smooth. Narrower means
# follow the spectral lines of a rotor, but have a larger random error.
LINE_HZ = 40.0
NOISE_HZ = 260.0
# Smallest incoherent share of the power: no outdoor sound is more coherent between two microphones. Without it a loudspeaker
# without any noise is heard on the opposite side of a cube of microphones in 8 of 174 windows.
MISMATCH = 0.002
# Ratio of reflected to direct power of a source: at all frequencies (as of a ground that absorbs 90 %), and in addition where
# diffuse sound is coherent (at a room's critical distance both are equal).
REFLECTED = 0.1
DIFFUSE = 1.0
# Upper limit of the ratio of reflections to incoherent noise: with less incoherent power there is no reverberation. What it and
# WEAK buy is in docs/decisions.md (0 to 4 points more beyond 20 deg in rooms without).
MAX_REFLECTED = 5.0
# Power of bins below that of any converter, so that a dead channel is no division by zero.
LEAST_POWER = 1e-18
# The band-pass filter applies where the source exceeds the noise by less than this factor.
WEAK = 1.3


@dataclass(frozen=True)
class Band:
    """Properties of the bins for all windows.

    Parameters:
        bin_hz (Hz): distance of the bins.
        response (k,): |H|^2 of the band-pass filter.
        diffuse (p, k): squared coherence of diffuse sound for each pair of microphones.
    """

    bin_hz: float
    response: NDArray
    diffuse: NDArray

    @classmethod
    def of(cls, frequencies: NDArray, response: NDArray, distances: NDArray, speed_of_sound: float) -> Band:
        """Band of bins, with the coherence of diffuse sound by Cook et al. (1955).

        Parameters:
            frequencies (k,) (Hz): frequencies of the bins.
            response (k,): |H|^2 of the band-pass filter.
            distances (p,) (m): distances of the microphones of each pair.
            speed_of_sound (m/s): speed of sound.
        """
        coherence = np.sinc(2.0 * np.outer(distances, frequencies) / speed_of_sound)
        return cls(float(frequencies[1] - frequencies[0]), response.astype(np.float32), (coherence**2).astype(np.float32))


Weighting = Callable[[NDArray, NDArray, Band], NDArray]


def cross_spectra(spectra: NDArray, pairs: NDArray) -> NDArray:
    """Cross-spectra X_i conj(X_j) (p, k) of spectra (m, k) for pairs (p, 2).

    Parameters:
        spectra (m, k): complex spectra of the microphones.
        pairs (p, 2): indices of the microphones of each pair.
    """
    return spectra[pairs[:, 0]] * spectra[pairs[:, 1]].conj()


def phat(cross: NDArray, power: NDArray, band: Band) -> NDArray:
    """Phase transform: all bins of the band have equal weight (Knapp and Carter, 1976). Real weights (p, k).

    Parameters:
        cross (p, k): cross-spectra of the pairs.
        power (p, k): sqrt(P_i P_j) of the same pairs. Not used.
        band: properties of the bins.
    """
    magnitude = np.abs(cross)
    return np.divide(band.response, magnitude, out=np.zeros_like(magnitude), where=magnitude >= TINY)


def plain(cross: NDArray, power: NDArray, band: Band) -> NDArray:
    """No weighting: the plain cross-correlation, best in white noise without reflections. Real weights (p, k).

    Parameters:
        cross (p, k): cross-spectra of the pairs. Not used.
        power (p, k): sqrt(P_i P_j) of the same pairs.
        band: properties of the bins.
    """
    return np.broadcast_to(band.response / max(float(power.mean()), TINY), power.shape)


def maximum_likelihood(cross: NDArray, power: NDArray, band: Band) -> NDArray:
    """Weights (p, k) of the maximum-likelihood delay for a source in noise and reflections.

    For source power S and noise N the likelihood's weight of a cross-spectrum is S / (N (2 S + N)) (Knapp and Carter,
    1976, eq. 51). Reflections are noise proportional to the source, so N becomes N + r S (Zhang, Florencio and Zhang,
    ICASSP 2008): lines far above the noise then have equal weight, as with PHAT, and bins without signal hardly any. r is
    larger at low frequencies, where the diffuse sound of a room is coherent and resembles a source at broadside; r S is
    limited to a few N, as reflections also make sound incoherent. S and N are estimated from the window: noise is what is
    incoherent between the microphones. The band-pass filter applies only where S does not exceed N clearly.

    Parameters:
        cross (p, k): cross-spectra of the pairs.
        power (p, k): sqrt(P_i P_j) of the same pairs.
        band: properties of the bins.
    """
    smooth, noise = smooth_and_noise(cross, power, band.bin_hz)
    source = np.maximum(smooth - noise, 0.05 * noise)
    disturbed = noise + np.minimum((REFLECTED + DIFFUSE * band.diffuse) * source, MAX_REFLECTED * noise)
    strength = np.square(np.square(np.minimum(source / (WEAK * noise), 100.0)))
    passed = 1.0 - (1.0 - band.response) / (1.0 + strength)
    return passed * source / (disturbed * (2.0 * source + disturbed))


def smooth_and_noise(cross: NDArray, power: NDArray, bin_hz: float) -> tuple[NDArray, NDArray]:
    """Running mean of the power (p, k), and incoherent power (p, k) between the microphones of each pair.

    Parameters:
        cross (p, k): cross-spectra of the pairs.
        power (p, k): sqrt(P_i P_j) of the same pairs.
        bin_hz (Hz): distance of the bins.
    """
    smooth, real, imaginary = _smooth(np.stack([power, cross.real, cross.imag]), LINE_HZ / bin_hz)
    noise = _smooth(np.maximum(smooth - np.sqrt(real**2 + imaginary**2), MISMATCH * smooth), NOISE_HZ / bin_hz)
    return smooth, np.maximum(noise, 1e-9 * power.mean(axis=-1, keepdims=True) + LEAST_POWER)


def _smooth(values: NDArray, bins: float) -> NDArray:
    return uniform_filter1d(values, max(1, round(bins)), axis=-1, mode='nearest')
