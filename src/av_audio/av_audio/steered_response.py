"""Delay estimation: direction as the maximum of the weighted correlation of all microphone pairs.

For two microphones this is the generalised cross-correlation (GCC), for more the steered response power (SRP).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.drift import DriftEstimator, is_positive
from av_audio.ego_noise import EgoNoise
from av_audio.weighting import Band, Weighting, cross_spectra
from av_common.microphone_array import MicrophoneArray

# The search extends beyond the physical delays by this factor, so that small errors of the geometry do not cut a peak at
# end-fire.
MARGIN = 1.05
GRID_POINTS_PER_PERIOD = 8.0
NEWTON_STEPS = 2
# Neighbouring bins share a spectral line and the taper's main lobe, so their errors are correlated: they form one cluster.
CLUSTER_HZ = 16.0
# The scatter is measured at the maximum, where noise is partly fitted, the more so the weaker the peak: the covariance is
# enlarged accordingly.
OPTIMISM = 2.0
# Phase errors of reflections vary within this width, those of a body between the microphones more slowly.
SMOOTH_HZ = 800.0


@dataclass(frozen=True)
class Peak:
    """Maximum of the steered response.

    Parameters:
        q (rank,): projection of the direction on the array's basis.
        covariance (rank, rank): covariance of q.
        bias (rank, rank): mean square of the additional shift of q by early reflections.
        significance: height over the standard deviation that independent channels would give.
        main_share: posterior probability 0..1 that this maximum is the true one among all of the curve.
    """

    q: NDArray
    covariance: NDArray
    bias: NDArray
    significance: float
    main_share: float


class SteeredResponse:
    """Weighted steered response J(q) = Re sum_pairs sum_f W(f) exp(-j 2 pi f tau_pair(q)), maximised over q.

    A grid search finds the highest lobe, Newton steps on the continuous function find its maximum: there is no grid of
    samples and therefore no interpolation bias. The covariance is the sandwich estimate H^-1 (sum u u^T) H^-1 from the
    scatter of the clusters' scores u (White, 1982), which covers noise and late reverberation; the effect of early
    reflections is estimated separately. The maximum is that of the whole window; where the direction moves within it, it is
    shifted to that at the centre (`drift.py`).

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the bins.
        response (k,): |H|^2 of the band-pass filter.
        speed_of_sound (m/s): speed of sound.
        weighting: gives the weights of the cross-spectra.
        ego_noise: model of the rig's own noise, whose covariance is subtracted; None subtracts nothing.
    """

    FOLLOWS_MOTION = True

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, response: NDArray, speed_of_sound: float,
                 weighting: Weighting, ego_noise: EgoNoise | None = None) -> None:
        self._ego_noise = ego_noise
        self._array = array
        self._weighting = weighting
        self._band = Band.of(frequencies, response, np.linalg.norm(array.baselines, axis=1), speed_of_sound)
        self._omega = (2.0 * np.pi * frequencies).astype(np.float32)
        self._slowness = array.baselines @ array.basis / speed_of_sound  # (p, rank): tau = slowness . q
        self._clusters = np.arange(0, len(frequencies), max(1, round(CLUSTER_HZ / self._band.bin_hz)))
        step = 1.0 / (GRID_POINTS_PER_PERIOD * frequencies[-1])
        reach = MARGIN * array.aperture / speed_of_sound
        delays = np.linspace(0.0, reach, int(np.ceil(reach / step)) + 1)
        self._delays = np.concatenate([-delays[:0:-1], delays])
        # for delays >= 0: those of negative delays differ in the sign of the sines only
        angles = np.outer(delays, 2.0 * np.pi * frequencies)
        self._cosines, self._sines = np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
        self._grid = _grid(array.rank, array.aperture / speed_of_sound / step)
        self._drift = DriftEstimator(array, frequencies, speed_of_sound)
        self._grid_delays = self._grid @ self._slowness.T  # (g, p)

    def estimate(self, spectra: NDArray) -> Peak:
        """The highest peak for spectra (m, k)."""
        pairs = self._array.pairs
        cross = cross_spectra(spectra, pairs)
        ego_noise = None
        if self._ego_noise is not None:
            ego_noise = self._ego_noise.covariance_in(spectra)[pairs[:, 0], pairs[:, 1]]
            cross = cross - ego_noise
        magnitude = np.abs(spectra)
        power = magnitude[pairs[:, 0]] * magnitude[pairs[:, 1]]
        weights = self._weighting(cross, power, self._band)
        weighted = cross * weights
        curve = self.curve(weighted)
        peak = self._peak(weighted, self._search(spectra, weighted, curve), curve)
        if not (self.FOLLOWS_MOTION and self._drift.usable) or peak.significance <= 0.0:
            return peak
        drift = self._drift.estimate(spectra, weights, ego_noise, peak.q)
        return replace(peak, q=peak.q - drift.shift, covariance=drift.steadier * peak.covariance + drift.covariance)

    def curve(self, weighted: NDArray) -> NDArray:
        """J on the grid of directions (g,) for weighted cross-spectra (p, k)."""
        even, odd = weighted.real @ self._cosines.T, weighted.imag @ self._sines.T
        by_delay = np.concatenate([(even - odd)[:, :0:-1], even + odd], axis=1)  # (p, delays)
        if self._array.channels == 2:
            return np.interp(self._grid_delays[:, 0], self._delays, by_delay[0])
        return sum(np.interp(delays, self._delays, response)
                   for delays, response in zip(self._grid_delays.T, by_delay, strict=True))

    def _steer(self, weighted: NDArray, q: NDArray) -> NDArray:
        """Weighted cross-spectra (p, k) with the phases of the delays of q removed: real where they agree with q."""
        angles = (self._slowness @ q).astype(np.float32)[:, None] * self._omega
        return weighted * (np.cos(angles) - 1j * np.sin(angles))

    def _search(self, spectra: NDArray, weighted: NDArray, curve: NDArray) -> NDArray:
        """Position q (rank,) of the maximum.

        Parameters:
            spectra (m, k): spectra of the window.
            weighted (p, k): weighted cross-spectra.
            curve (g,): J on the grid of directions.
        """
        start = q = self._grid[np.argmax(curve)]
        reach = 2.0 / (GRID_POINTS_PER_PERIOD * self._omega[-1] / (2.0 * np.pi)) / np.abs(self._slowness).max()
        for _ in range(NEWTON_STEPS):
            gradient, hessian = self._derivatives(self._steer(weighted, q))
            if not is_positive(hessian):
                return start
            q = np.clip(q + np.linalg.solve(hessian, gradient), start - reach, start + reach)
        return q

    def _derivatives(self, steered: NDArray) -> tuple[NDArray, NDArray]:
        """Gradient (rank,) and negative Hessian (rank, rank) of J."""
        first = steered.imag @ self._omega
        second = steered.real @ self._omega**2
        return self._slowness.T @ first, (self._slowness.T * second) @ self._slowness

    def _peak(self, weighted: NDArray, q: NDArray, curve: NDArray) -> Peak:
        steered = self._steer(weighted, q)
        _, hessian = self._derivatives(steered)
        clusters = np.add.reduceat(steered.sum(axis=0), self._clusters)
        height = float(clusters.real.sum())
        spread = float(np.sqrt(0.5 * np.sum(np.abs(clusters) ** 2)))
        if spread == 0.0 or height <= 0.0 or not is_positive(hessian):
            return Peak(q, np.full_like(hessian, np.inf), np.zeros_like(hessian), 0.0, 0.0)
        scores = np.add.reduceat(self._slowness.T @ (steered.imag * self._omega), self._clusters, axis=1)
        inverse = np.linalg.inv(hessian)
        significance = height / spread
        covariance = inverse @ (scores @ scores.T) @ inverse * (1.0 + (OPTIMISM / significance) ** 2) ** 2
        bias = _reflection_variance(clusters) * height * inverse
        return Peak(q, covariance, bias, significance, self._main_share(q, covariance, hessian, height, curve))

    def _main_share(self, q: NDArray, covariance: NDArray, hessian: NDArray, height: float, curve: NDArray) -> float:
        """Posterior probability of the peak's lobe. The curve is a log-likelihood up to a scale, which the covariance gives."""
        rank = len(q)
        trace = float(np.sum(covariance * hessian))  # of their product, as both are symmetric
        if trace <= 0.0:
            return 1.0
        log_likelihood = (curve - height) * rank / trace
        # half-width of a lobe: a quarter period of the mean frequency of the peak
        lobe = 0.5 * np.pi * np.sqrt(height * rank / np.trace(hessian))
        outside = np.abs(self._grid - q).max(axis=1) > lobe
        cell = (2.0 * MARGIN) ** rank / len(self._grid)
        others = cell * float(np.exp(np.minimum(log_likelihood[outside], 0.0)).sum())
        main = float(np.sqrt((2.0 * np.pi) ** rank * np.linalg.det(covariance)))
        return main / (main + others)


def _reflection_variance(clusters: NDArray) -> float:
    """Variance in rad^2 of the phase errors that neighbouring clusters (c,) share: that of reflections without noise.

    A strong early reflection shifts the phases of neighbouring clusters by similar amounts and may bias the peak by as
    much. Noise is independent between clusters, so that its products have zero mean; their standard deviation is
    subtracted. Phases that vary slowly, over the width of SMOOTH_HZ, stem from a body between the microphones, which
    calibration covers.
    """
    width = round(SMOOTH_HZ / CLUSTER_HZ)
    slow = uniform_filter1d(clusters, width, mode='nearest')
    scale = np.maximum(slow.real, np.abs(slow.imag))  # 0 where ego-rotors are notched
    imaginary = clusters.imag - clusters.real * slow.imag / np.maximum(scale, np.finfo(float).tiny)
    products = imaginary[1:] * imaginary[:-1]
    reference = float(np.sum(clusters.real[1:] * clusters.real[:-1]))
    excess = float(products.sum() - np.sqrt(np.sum(products**2)))
    return excess / reference if excess > 0.0 and reference > 0.0 else 0.0


def _grid(rank: int, points_per_unit: float) -> NDArray:
    """Points (g, rank) that fill the ball |q| <= MARGIN (a unit sphere for rank 3), dense enough not to miss a lobe."""
    line = np.linspace(-MARGIN, MARGIN, 2 * int(np.ceil(MARGIN * points_per_unit)) + 1)
    if rank == 1:
        return line[:, None]
    points = np.stack(np.meshgrid(*[line] * rank, indexing='ij'), -1).reshape(-1, rank)
    radius = np.linalg.norm(points, axis=1)
    if rank == 2:
        return points[radius <= MARGIN]
    return points[np.abs(radius - 1.0) < 1.0 / points_per_unit]
