"""Weighted correlation of all pairs of microphones: the generalised cross-correlation and steered response power."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_audio.drift import Drift, DriftEstimator
from av_audio.steered_response import Peak, SteeredResponse
from av_audio.weighting import Band, Weighting, cross_spectra
from av_common.microphone_array import MicrophoneArray

# Neighbouring bins share a spectral line and the taper's main lobe, so their errors are correlated: they form one cluster.
CLUSTER_HZ = 16.0


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
        self._band = Band.of(frequencies, response, distances, speed_of_sound)
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
        pairs, magnitude = self._baselines.pairs, np.abs(spectra)
        return cross_spectra(spectra, pairs), magnitude[pairs[:, 0]] * magnitude[pairs[:, 1]]

    def _reflections(self, clusters: NDArray, height: float, inverse: NDArray) -> NDArray:
        return _reflection_variance(clusters) * height * inverse


def at_centre(peak: Peak, drift: Drift | None) -> Peak:
    """A peak of the whole window, moved by the drift to where the source is at its centre."""
    if drift is None:
        return peak
    return replace(peak, q=peak.q - drift.shift, covariance=drift.steadier * peak.covariance + drift.covariance)


def _reflection_variance(clusters: NDArray) -> float:
    """Variance in rad^2 of the phase errors that neighbouring clusters (c,) share: that of reflections without noise.

    A strong early reflection shifts the phases of neighbouring clusters by similar amounts and may bias the peak by as
    much. Noise is independent between clusters, so that its products have zero mean; their standard deviation is
    subtracted.
    """
    products = clusters.imag[1:] * clusters.imag[:-1]
    reference = float(np.sum(clusters.real[1:] * clusters.real[:-1]))
    excess = float(products.sum() - np.sqrt(np.sum(products**2)))
    return excess / reference if excess > 0.0 and reference > 0.0 else 0.0
