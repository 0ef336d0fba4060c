"""Weighted correlation of all pairs of microphones: the generalised cross-correlation and steered response power."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.drift import Drift, DriftEstimator
from av_audio.spectra import TINY
from av_audio.steered_response import Peak, SteeredResponse
from av_common.microphone_array import MicrophoneArray

# Neighbouring bins share a spectral line and the taper's main lobe, so their errors are correlated: they form one cluster.
CLUSTER_HZ = 16.0
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
        diffuse (p, k): squared coherence of diffuse sound for each pair of microphones (Cook et al., 1955).
    """

    bin_hz: float
    response: NDArray
    diffuse: NDArray


Weighting = Callable[[NDArray, NDArray, Band], NDArray]


class Correlation(SteeredResponse):
    """Steered response of the spectra of a whole window, with weights.

    The maximum is that of the whole window; where the direction moves within it, it is shifted to that at the centre
    (`drift.py`).

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the bins.
        response (k,): |H|^2 of the band-pass filter.
        speed_of_sound (m/s): speed of sound.
        weighting: gives the weights of the cross-spectra.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, response: NDArray, speed_of_sound: float,
                 weighting: Weighting) -> None:
        super().__init__(array, frequencies, speed_of_sound, CLUSTER_HZ)
        self._weighting = weighting
        first, second = array.positions[self._baselines.pairs.T]
        distances = np.linalg.norm(first - second, axis=1)
        coherence = np.sinc(2.0 * np.outer(distances, frequencies) / speed_of_sound)
        self._band = Band(float(frequencies[1] - frequencies[0]), response.astype(np.float32),
                          (coherence**2).astype(np.float32))
        self._drift = DriftEstimator(array, frequencies, speed_of_sound)

    def estimate(self, spectra: NDArray) -> Peak:
        """The highest peak for spectra (m, k), at the centre of the window."""
        peak, drift = self.at_rest(spectra)
        return at_centre(peak, drift)

    def at_rest(self, spectra: NDArray) -> tuple[Peak, Drift | None]:
        """The highest peak of the whole window, and the motion within it; None where there is no model of it.

        Parameters:
            spectra (m, k): spectra of the microphones.
        """
        cross, power = self._cross(spectra)
        weights = self._weighting(cross, power, self._band)
        peak = self.highest_peak(self._baselines.sum(cross * weights))
        if not self._drift.usable or peak.significance <= 0.0:
            return peak, None
        return peak, self._drift.estimate(spectra, weights, peak.q)

    def _cross(self, spectra: NDArray) -> tuple[NDArray, NDArray]:
        """Cross-spectra (p, k) and sqrt(P_i P_j) of the same pairs."""
        (first, second), magnitude = self._baselines.pairs.T, np.abs(spectra)
        return spectra[first] * spectra[second].conj(), magnitude[first] * magnitude[second]

    def _reflections(self, clusters: NDArray, height: float, inverse: NDArray) -> NDArray:
        """By the phase errors that neighbouring clusters (c,) share, in rad^2: those of reflections without noise.

        A strong early reflection shifts the phases of neighbouring clusters by similar amounts and may bias the peak by as
        much. Noise is independent between clusters, so that its products have zero mean; their standard deviation is
        subtracted.
        """
        products = clusters.imag[1:] * clusters.imag[:-1]
        reference = float(np.sum(clusters.real[1:] * clusters.real[:-1]))
        excess = float(products.sum() - np.sqrt(np.sum(products**2)))
        return (excess / reference if excess > 0.0 and reference > 0.0 else 0.0) * height * inverse


def at_centre(peak: Peak, drift: Drift | None) -> Peak:
    """A peak of the whole window, moved by the drift to where the source is at its centre."""
    if drift is None:
        return peak
    return replace(peak, q=peak.q - drift.shift, covariance=peak.covariance + drift.covariance)


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
