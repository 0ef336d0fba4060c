"""Delay estimation: direction as the maximum of the weighted correlation of all microphone pairs.

For two microphones this is the generalised cross-correlation (GCC), for more the steered response power (SRP).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import csr_array

from av_audio.baselines import Baselines
from av_audio.drift import GRID_POINTS_PER_PERIOD, is_positive
from av_audio.spectra import TINY
from av_common.microphone_array import MicrophoneArray

# The search extends beyond the physical delays by this factor, so that small errors of the geometry do not cut a peak at
# end-fire.
MARGIN = 1.05
NEWTON_STEPS = 2  # one leaves 0.03 deg to a square of 65 mm at 15 dB: 85 instead of 91 % are within 1.64 sigma
# A direction (q, a cosine) closer than this to a peak is near it: 20 degrees from broadside.
NEAR = 0.34
# Logistic model of the probability that a peak stems from a source, by its significance: 0.5 at 2.8. Both numbers were
# fitted to the share of wrong peaks over simulated drones in noise; `ros2 run av_evaluation hearing accuracy` checks them.
EVEN_SIGNIFICANCE = 2.8
SIGNIFICANCE_SLOPE = 1.9
# The scatter is measured at the maximum, where noise is partly fitted, the more so the less the peak is over chance: the
# covariance is enlarged accordingly.
OPTIMISM = 2.0


@dataclass(frozen=True)
class Peak:
    """Maximum of the steered response.

    Parameters:
        q (rank,): projection of the direction on the array's basis.
        covariance (rank, rank): covariance of q.
        bias (rank, rank): mean square of the additional shift of q by early reflections.
        significance: height in standard deviations, or the normal quantile of its probability, if channels are independent.
        main_share: posterior probability 0..1 that this maximum is the true one among all of the curve.
        height: value of the steered response.
        reflected: power of what is reflected, over that of what arrives directly; 0 where unknown.
        over_alone: probability that it stems from a source, where peaks of the rig alone are known; else None.
        curve (2, g): places q on a line, and the steered response there, whose peaks are alternatives; None where unknown.
    """

    q: NDArray
    covariance: NDArray
    bias: NDArray
    significance: float
    main_share: float
    height: float = 0.0
    reflected: float = 0.0
    over_alone: float | None = None
    curve: NDArray | None = None

    @property
    def source_probability(self) -> float:
        """Probability that it stems from a source."""
        if self.over_alone is not None:
            return self.over_alone
        return 1.0 / (1.0 + math.exp(-SIGNIFICANCE_SLOPE * (self.significance - EVEN_SIGNIFICANCE)))


class SteeredResponse:
    """Weighted steered response J(q) = Re sum_pairs sum_f W(f) exp(-j 2 pi f tau_pair(q)), maximised over q.

    A grid search finds the highest lobe, Newton steps on the continuous function find its maximum: there is no grid of
    samples and therefore no interpolation bias. The covariance is the sandwich estimate H^-1 (sum u u^T) H^-1 from the
    scatter of the clusters' scores u (White, 1982), which covers noise and late reverberation; the effect of early
    reflections is estimated separately.

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the bins, in rising order.
        speed_of_sound (m/s): speed of sound.
        cluster_hz (Hz): width of the clusters of bins, between which the errors by noise are independent.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float, cluster_hz: float) -> None:
        self._array, self._baselines = array, Baselines(array)
        self._omega = (2.0 * np.pi * frequencies).astype(np.float32)
        self._slowness = self._baselines.vectors @ array.basis / speed_of_sound  # (u, rank): tau = slowness . q
        self._clusters = np.unique(np.searchsorted(frequencies, np.arange(frequencies[0], frequencies[-1], cluster_hz)))
        self._cluster_sizes = np.diff([*self._clusters, len(frequencies)])
        step = 1.0 / (GRID_POINTS_PER_PERIOD * frequencies[-1])
        reach = MARGIN * array.aperture / speed_of_sound
        delays = np.linspace(0.0, reach, int(np.ceil(reach / step)) + 1)
        # for delays >= 0: those of negative delays differ in the sign of the sines only
        angles = np.outer(delays, 2.0 * np.pi * frequencies)
        self._cosines, self._sines = np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
        self.grid = direction_grid(array.rank, array.aperture / speed_of_sound / step)
        self._axes = np.ascontiguousarray(self.grid.T)  # (rank, g): sums over axes are faster by rows
        self._to_grid = _interpolation(self.grid @ self._slowness.T, reach, 2 * len(delays) - 1)

    def highest_peak(self, weighted: NDArray) -> Peak:
        """The highest peak of weighted cross-spectra (u, k) by baseline."""
        curve = self.curve(weighted)
        return self._peak(weighted, self._search(weighted, curve), curve)

    def curve(self, weighted: NDArray) -> NDArray:
        """J on the grid of directions (g,) for weighted cross-spectra (u, k)."""
        even, odd = weighted.real @ self._cosines.T, weighted.imag @ self._sines.T
        return self._to_grid @ np.concatenate([(even - odd)[:, :0:-1], even + odd], axis=1).ravel()

    def _steer(self, weighted: NDArray, q: NDArray) -> NDArray:
        """Weighted cross-spectra (u, k) with the phases of the delays of q removed: real where they agree with q."""
        angles = (self._slowness @ q).astype(np.float32)[:, None] * self._omega
        return weighted * (np.cos(angles) - 1j * np.sin(angles))

    def _search(self, weighted: NDArray, curve: NDArray) -> NDArray:
        """Position q (rank,) of the maximum.

        Parameters:
            weighted (u, k): weighted cross-spectra.
            curve (g,): J on the grid of directions.
        """
        start = q = self.grid[np.argmax(curve)]
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
        parts = np.add.reduceat(steered, self._clusters, axis=1)
        clusters = parts.sum(axis=0)
        height = float(clusters.real.sum())
        over_spread = over_chance(clusters)
        if over_spread <= 0.0 or not is_positive(hessian):
            return Peak(q, np.full_like(hessian, np.inf), np.zeros_like(hessian), 0.0, 0.0)
        scores = np.add.reduceat(self._slowness.T @ (steered.imag * self._omega), self._clusters, axis=1)
        inverse = np.linalg.inv(hessian)
        covariance = inverse @ (scores @ scores.T) @ inverse * (1.0 + (OPTIMISM / over_spread) ** 2) ** 2
        bias = self._reflections(clusters, height, inverse)
        trace = float(np.sum(covariance * hessian))  # of their product, as both are symmetric
        log_likelihood = (curve - height) * len(hessian) / max(trace, TINY)  # the covariance gives its scale
        main_share = self._main_share(q, covariance, hessian, height, log_likelihood)
        return Peak(q, covariance, bias, self._significance_of(parts), main_share, height)

    def _along_weakest_axis(self, parts: NDArray) -> NDArray:
        """Clusters (c,) of the baselines that measure q along the axis along which they agree least, by how much they do.

        Where one of three microphones hears something else, two of them tell one axis, and along the other is a peak by chance.

        Parameters:
            parts (u, c): clusters by baseline, as steered.
        """
        agreeing = (self._slowness.T * parts.real.sum(axis=1)) @ self._slowness
        axis = eigh(agreeing, self._slowness.T @ self._slowness)[1][:, 0]  # relative to what the array measures
        return np.asarray((self._slowness @ axis) ** 2 @ parts)

    def _reflections(self, clusters: NDArray, height: float, inverse: NDArray) -> NDArray:
        """Mean square (rank, rank) of the shift of q by early reflections; none unless overridden.

        Parameters:
            clusters (c,): steered cross-spectra, summed over clusters of bins.
            height: height of the peak.
            inverse (rank, rank): inverse of the negative Hessian.
        """
        return np.zeros_like(inverse)

    def _significance_of(self, parts: NDArray) -> float:
        """Significance of a peak of clusters by baseline (u, c), as steered: of all of them, and along each axis."""
        of_all = self._rarity(parts.sum(axis=0))
        return of_all if len(self._axes) == 1 else min(of_all, self._rarity(self._along_weakest_axis(parts)))

    def _rarity(self, clusters: NDArray) -> float:
        """Significance of clusters (c,), as steered."""
        return over_chance(clusters)

    def _main_share(self, q: NDArray, covariance: NDArray, hessian: NDArray, height: float, log_likelihood: NDArray) -> float:
        """Posterior probability of the peak's lobe."""
        rank = len(q)
        # half-width of a lobe: a quarter period of the mean frequency of the peak
        lobe = 0.5 * np.pi * np.sqrt(height * rank / np.trace(hessian))
        outside = np.abs(self._axes - q[:, None]).max(axis=0) > lobe
        cell = (2.0 * MARGIN) ** rank / len(self.grid)
        others = cell * float(np.exp(np.minimum(log_likelihood[outside], 0.0)).sum())
        main = math.sqrt((2.0 * np.pi) ** rank * max(float(np.linalg.det(covariance)), 0.0))
        return main / (main + others) if main > 0.0 else 1.0


def over_chance(clusters: NDArray) -> float:
    """Height of a peak over the standard deviation that independent channels would give; `clusters` (c,) as steered."""
    spread = math.sqrt(0.5 * float(np.sum(np.abs(clusters) ** 2)))
    return float(clusters.real.sum()) / spread if spread > 0.0 else 0.0


def _interpolation(delays: NDArray, reach: float, count: int) -> csr_array:
    """Matrix (g, u count) that interpolates values at `count` even delays of each baseline and adds those of all baselines.

    Parameters:
        delays (g, u) (s): delay of each baseline for each direction; beyond both ends the value there counts.
        reach (s): the largest of the even delays, from -reach on.
        count: their number.
    """
    directions, baselines = delays.shape
    place = np.clip((delays / reach + 1.0) * 0.5 * (count - 1), 0.0, count - 1.0)
    below = np.minimum(place.astype(int), count - 2)
    columns = np.stack([below, below + 1], axis=-1) + count * np.arange(baselines)[:, None]
    weights = np.stack([below + 1.0 - place, place - below], axis=-1).astype(np.float32)
    return csr_array((weights.ravel(), columns.ravel(), 2 * baselines * np.arange(directions + 1)),
                     shape=(directions, baselines * count))


def with_other_lobes(q: NDArray, covariance: NDArray, grid: NDArray, weights: NDArray) -> tuple[NDArray, float]:
    """Covariance (rank, rank) of q if it is near its peak, lobes beside it included, and the probability that it is near.

    Parameters:
        q (rank,): the peak.
        covariance (rank, rank): of its lobe, with a density of 1 at q.
        grid (g, rank): other places.
        weights (g,): density at these times their size; 0 in the peak's lobe.
    """
    values = np.linalg.eigvalsh(covariance)[-min(len(q), 2):]  # on a sphere nothing moves along its radius
    main = math.sqrt(float(np.prod(2.0 * np.pi * values)))
    apart = grid - q
    near = weights * (np.einsum('gr,gr->g', apart, apart) < NEAR**2)
    beside = main + float(near.sum())
    if beside == 0.0:
        return covariance, 1.0
    spread = (main * covariance + (near[:, None] * apart).T @ apart) / beside
    return spread, beside / (main + float(weights.sum()))


def direction_grid(rank: int, points_per_unit: float) -> NDArray:
    """Points (g, rank) that fill the ball |q| <= MARGIN (a unit sphere for rank 3), dense enough not to miss a lobe."""
    if rank == 3:    # a Fibonacci lattice
        count = max(4, int(np.ceil(4.0 * np.pi * points_per_unit**2)))  # fewer span no space
        up = 1.0 - (2.0 * np.arange(count) + 1.0) / count
        turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
        return np.stack([np.cos(turn) * np.sqrt(1.0 - up**2), np.sin(turn) * np.sqrt(1.0 - up**2), up], axis=1)
    line = np.linspace(-MARGIN, MARGIN, 2 * int(np.ceil(MARGIN * points_per_unit)) + 1)
    if rank == 1:
        return line[:, None]
    points = np.stack(np.meshgrid(line, line, indexing='ij'), -1).reshape(-1, 2)
    return points[np.linalg.norm(points, axis=1) <= MARGIN]
