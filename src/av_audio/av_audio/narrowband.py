"""MUSIC and MVDR as baselines: narrow-band search, with variance and confidence of the steered response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from av_audio.correlation import Correlation
from av_audio.ego_noise import EgoNoise
from av_audio.weighting import Weighting
from av_common.microphone_array import MicrophoneArray

# The bins of a band of this width are the snapshots of one covariance matrix: enough of them to average, close enough to
# share phases.
BAND_HZ = 40.0
LOADING = 1e-3
ZOOM_ROUNDS = 6


class NarrowbandSearch(Correlation):
    """Finds q by a cost summed over narrow bands, on a grid and then on successively finer grids around its minimum.

    Variance and confidence are those of the weighted correlation at the q found; motion within a window is not modelled. The
    parameters are those of Correlation.
    """

    FOLLOWS_MOTION = False

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, response: NDArray, speed_of_sound: float,
                 weighting: Weighting, ego_noise: EgoNoise | None = None) -> None:
        super().__init__(array, frequencies, response, speed_of_sound, weighting, ego_noise)
        bins = max(array.channels, round(BAND_HZ / self._band.bin_hz))
        self._bands = len(frequencies) // bins
        self._used = self._bands * bins
        centres = frequencies[:self._used].reshape(self._bands, bins).mean(axis=1)
        self._weights = response[:self._used].reshape(self._bands, bins).mean(axis=1)[:, None]
        # phase per unit of q (bands, m, rank): nearer microphones are ahead
        self._phase = 2.0 * np.pi * centres[:, None, None] * (array.positions @ array.basis) / speed_of_sound
        self._grid_steering = self._steering(self.grid)

    def _search(self, spectra: NDArray, weighted: NDArray, curve: NDArray) -> NDArray:
        bands = spectra[:, :self._used].reshape(len(spectra), self._bands, -1).transpose(1, 0, 2)
        covariances = bands @ bands.conj().swapaxes(1, 2)
        if self.ego_noise is not None:
            covariances = self._without_ego_noise(covariances, self.ego_noise.covariance_in(spectra))
        trace = np.trace(covariances, axis1=1, axis2=2).real
        covariances = covariances / np.maximum(trace, np.finfo(np.float32).tiny)[:, None, None]
        matrices = self._matrices(covariances)
        q = self.grid[np.argmin(self._cost(matrices, self._grid_steering))]
        step = 1.0 / np.sqrt(len(self.grid))
        around = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 9)] * len(q), indexing='ij'), -1).reshape(-1, len(q))
        for _ in range(ZOOM_ROUNDS):
            candidates = q + step * around
            q = candidates[np.argmin(self._cost(matrices, self._steering(candidates)))]
            step /= 4.0
        return q

    def _without_ego_noise(self, covariances: NDArray, ego_noise: NDArray) -> NDArray:
        """Covariances (bands, m, m) less those of the ego-noise (m, m, k), negative eigenvalues set to 0."""
        noise = ego_noise[..., :self._used]
        noise = noise.reshape(*noise.shape[:2], self._bands, -1).sum(axis=-1).transpose(2, 0, 1)
        values, vectors = np.linalg.eigh(covariances - noise)
        return (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.conj().swapaxes(1, 2)

    def _steering(self, points: NDArray) -> NDArray:
        """Steering vectors (bands, m, g) of points (g, rank)."""
        return np.exp(1j * (self._phase @ points.T)).astype(np.complex64)

    def _matrices(self, covariances: NDArray) -> NDArray:
        """Matrices (bands, m, n) that the cost uses, from covariances (bands, m, m)."""
        raise NotImplementedError

    def _cost(self, matrices: NDArray, steering: NDArray) -> NDArray:
        """Cost (g,) of steering vectors (bands, m, g), lowest in the direction of the source."""
        raise NotImplementedError


class Music(NarrowbandSearch):
    """MUSIC: power of the steering vector in the noise subspace of one source (Schmidt, 1986), summed over bands."""

    def _matrices(self, covariances: NDArray) -> NDArray:
        return np.linalg.eigh(covariances)[1][:, :, -1:]

    def _cost(self, matrices: NDArray, steering: NDArray) -> NDArray:
        power = np.abs(matrices.conj().swapaxes(1, 2) @ steering)[:, 0] ** 2
        return -np.sum(self._weights * power, axis=0)


class Mvdr(NarrowbandSearch):
    """MVDR: output power of the minimum-variance distortionless beam (Capon, 1969), over bands scaled to equal power."""

    def _matrices(self, covariances: NDArray) -> NDArray:
        return np.linalg.inv(covariances + LOADING * np.eye(covariances.shape[1], dtype=covariances.dtype))

    def _cost(self, matrices: NDArray, steering: NDArray) -> NDArray:
        power = 1.0 / np.sum(steering.conj() * (matrices @ steering), axis=1).real
        return -np.sum(self._weights * power, axis=0)
