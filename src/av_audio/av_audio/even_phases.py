"""Phases with equal weights, at several resolutions in time: robust where reflections contradict a likelihood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.reflections import Reflections
from av_audio.spectra import TINY, Blocks, phases_of
from av_audio.steered_response import Peak, SteeredResponse
from av_common.microphone_array import MicrophoneArray

# Lengths of the blocks beside the whole window. Reverberation fills short blocks unevenly, so that some have more direct sound;
# long ones have more signal for their noise. No single length is best in all rooms.
BLOCKS_S = (0.016, 0.032)
# The phase error that a reflection with a delay T causes repeats with 1 / T: clusters of this width hold what those up to 4 ms
# share.
CLUSTER_HZ = 250.0
# Bins of the whole window that are summed, within which the phase of a delay hardly changes: by 3 deg for 0.2 m.
GROUP_HZ = 16.0
# Width over which the spectrum is made white before it is cut: strong frequencies would leak into weak ones, as those of wind.
WHITENING_HZ = 100.0
# Mean square error of q by reflections where bands do not agree at all; fitted to random rooms.
REFLECTED = 2.0


class EvenPhases(SteeredResponse):
    """Phase transform (Knapp and Carter, 1976), summed over blocks of several lengths.

    Each bin of each block has the same weight, and each length in all.

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the window's bins.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float) -> None:
        bin_hz = float(frequencies[1] - frequencies[0])
        self._blocks = [Blocks(frequencies, 0.5 * length) for length in BLOCKS_S if length * bin_hz < 0.5]
        self._smoothing = max(1, round(WHITENING_HZ / bin_hz))
        self._group = max(1, round(GROUP_HZ / bin_hz))
        self._grouped = len(frequencies) // self._group * self._group
        whole = frequencies[:self._grouped].reshape(-1, self._group).mean(axis=1)
        everything = np.concatenate([whole, *(blocks.frequencies for blocks in self._blocks)])
        self._order = np.argsort(everything, kind='stable')
        super().__init__(array, everything[self._order], speed_of_sound, CLUSTER_HZ)
        self._reflected = Reflections(array, frequencies, speed_of_sound)
        self._cluster_omega = np.add.reduceat(self._omega, self._clusters) / self._cluster_sizes.astype(np.float32)

    def estimate(self, spectra: NDArray) -> tuple[Peak, NDArray]:
        """The highest peak for spectra (m, k), and the mean square (rank, rank) of its shift by reflections from anywhere."""
        power = np.mean(np.abs(spectra) ** 2, axis=0)
        white = spectra / np.sqrt(np.maximum(uniform_filter1d(power, self._smoothing), TINY))
        phases = phases_of(spectra)
        whole = phases[:, :self._grouped].reshape(len(spectra), -1, self._group).swapaxes(1, 2)
        cut = (phases_of(blocks.spectra(white)) for blocks in self._blocks)
        weighted = np.concatenate([self._cross(part) for part in (whole, *cut)], axis=1)[:, self._order]
        peak = self.highest_peak(weighted)
        return self._among_reflections(peak, phases, weighted) if peak.significance > 0.0 else (peak, peak.bias)

    def _reflections(self, clusters: NDArray, height: float, inverse: NDArray) -> NDArray:
        agreement = height / float(np.abs(clusters).sum())
        return REFLECTED * (1.0 - agreement) ** 4 * np.eye(len(inverse))

    def _among_reflections(self, peak: Peak, phases: NDArray, weighted: NDArray) -> tuple[Peak, NDArray]:
        """A peak whose bias counts reflections from anywhere, and the mean square of the shift by those alone.

        The bias is that, or what disagreement of the bands states, if that is more: in windows shorter than the reverberation
        neighbouring bins have little in common.
        """
        ratio = self._reflected.ratio(phases, peak.q)
        steered = self._steer(weighted, peak.q)
        _, hessian = self._derivatives(steered)
        coherence = np.add.reduceat(steered.real, self._clusters, axis=1)
        pulled = ratio**2 * self._reflected.pull(coherence, self._cluster_omega, hessian, peak.q)
        return replace(peak, bias=max(pulled, peak.bias, key=np.trace), reflected=ratio), pulled

    def _cross(self, phases: NDArray) -> NDArray:
        """Cross-spectra (u, j) of phases (m, b, j), scaled so that all resolutions add up to a coherence of 1."""
        by_bin = np.ascontiguousarray(phases.transpose(2, 0, 1))
        products = by_bin @ by_bin.conj().swapaxes(1, 2)  # (j, m, m)
        first, second = self._baselines.pairs.T
        cross = self._baselines.sum(np.ascontiguousarray(products[:, first, second].T))
        return cross / (phases[0].size * len(first) * (1 + len(self._blocks)))
