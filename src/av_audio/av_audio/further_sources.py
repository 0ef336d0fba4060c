"""Directions of further sources in a window, from the phases that the strongest does not explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from av_audio.ego_noise import EgoNoise
from av_audio.steered_response import Peak, SteeredResponse
from av_audio.weighting import cross_spectra
from av_common.microphone_array import MicrophoneArray

MOST_SOURCES = 4
# Half of the width in rad within which the phase of a bin agrees with a direction.
AGREES_RAD = 0.25 * np.pi
# Bins that are summed, within which the phase of a delay hardly changes; and the width of the clusters of bins.
GROUP_HZ = 16.0
CLUSTER_HZ = 250.0
# Sources that are closer than this share of a wavelength of the mean frequency over the aperture are one direction.
SEPARATION = 0.36
# Significance of a further source; chance reaches it in one of a hundred windows.
LEAST_SIGNIFICANCE = 2.8
LEAST_SHARE = 0.5


class FurtherSources(SteeredResponse):
    """Finds sources one by one: bins whose phases agree with those found are left out, the others steered with even weights.

    Two sources rarely have the same bins at the same time (Yilmaz and Rickard, 2004), least so in those of the whole window,
    which are the narrowest.

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the bins.
        speed_of_sound (m/s): speed of sound.
        ego_noise: model of the rig's own noise, whose covariance is subtracted; None subtracts nothing.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float,
                 ego_noise: EgoNoise | None = None) -> None:
        group = max(1, round(GROUP_HZ / float(frequencies[1] - frequencies[0])))
        self._used = len(frequencies) // group * group
        bins = frequencies[:self._used].reshape(-1, group)
        super().__init__(array, bins.mean(axis=1), speed_of_sound, CLUSTER_HZ)
        self._bins = (2.0 * np.pi * bins).astype(np.float32)    # rad/s
        self._ego_noise = ego_noise
        _, neighbours = cKDTree(self._grid).query(self._grid, 3**array.rank)
        self._neighbours = neighbours[:, 1:]
        self._apart = SEPARATION * speed_of_sound / (float(frequencies.mean()) * array.aperture)

    def find(self, spectra: NDArray, strongest: NDArray, most: int) -> list[Peak]:
        """Peaks of all sources, that at `strongest` first; none where it is the only one.

        Parameters:
            spectra (m, k): spectra of the window.
            strongest (rank,): direction q of the strongest source.
            most: largest number of sources, up to MOST_SOURCES.
        """
        phases = self._phases(spectra)
        found = [strongest]
        while len(found) < most:
            peak = self._beside(phases, found)
            if peak is None or peak.significance < LEAST_SIGNIFICANCE or peak.main_share < LEAST_SHARE:
                break
            found.append(peak.q)
        if len(found) == 1:
            return []
        peaks = [self._beside(phases, found[:k] + found[k + 1:]) for k in range(len(found))]
        return [peak for peak in peaks if peak is not None]

    def _phases(self, spectra: NDArray) -> NDArray:
        """Unit phases (p, j, n) of the cross-spectra of spectra (m, k), in j groups of n bins."""
        pairs = self._array.pairs
        cross = cross_spectra(spectra, pairs)
        if self._ego_noise is not None:
            cross = cross - self._ego_noise.covariance_in(spectra)[pairs[:, 0], pairs[:, 1]]
        cross = cross[:, :self._used].reshape(len(pairs), *self._bins.shape)
        return cross / np.maximum(np.abs(cross), np.finfo(np.float32).tiny)

    def _without(self, phases: NDArray, found: Sequence[NDArray]) -> NDArray:
        """Sum (p, j) of the phases (p, j, n) that agree with none of the directions found.

        Of noise, whose phases are uniform, what is left has the mean -sin(a) / (pi - n a) exp(j w tau) for each of n
        directions, a being half of the width that is removed. It is added.
        """
        restored = np.float32(np.sin(AGREES_RAD) / (np.pi - AGREES_RAD * len(found)))
        kept, expected = phases != 0.0, np.zeros_like(phases)
        for q in found:
            angles = (self._slowness @ q).astype(np.float32)[:, None, None] * self._bins
            steering = np.cos(angles) + 1j * np.sin(angles)
            kept &= (phases * steering.conj()).real < np.cos(AGREES_RAD)
            expected += restored * steering
        return np.where(kept, phases + expected, 0.0).sum(axis=-1)

    def _beside(self, phases: NDArray, found: Sequence[NDArray]) -> Peak | None:
        """The highest peak of phases (p, j, n) at a distance from the directions found, after removing theirs; None without."""
        weighted = self._without(phases, found)
        curve = self.curve(weighted)
        free = np.all([np.linalg.norm(self._grid - q, axis=1) > self._apart for q in found], axis=0)
        tops = free & (curve >= curve[self._neighbours].max(axis=1))    # a slope of those found is none
        if not tops.any():
            return None
        curve = np.where(free, curve, curve.min())
        return self._peak(weighted, self._search(weighted, weighted, np.where(tops, curve, curve.min())), curve)

    def _reflections(self, clusters: NDArray, height: float, inverse: NDArray) -> NDArray:
        return np.zeros_like(inverse)
