"""Directions of further sources in a window, from the phases that the strongest does not explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from av_audio.even_phases import GROUP_HZ, is_no_reflection
from av_audio.spectra import ALIKE_HZ, phases_of
from av_audio.steered_response import EVEN_SIGNIFICANCE, Peak, SteeredResponse, over_chance
from av_common.microphone_array import MicrophoneArray

MOST_SOURCES = 4
# Half of the width in rad within which the phase of a bin agrees with a direction.
AGREES_RAD = 0.25 * np.pi
# Sources that are closer than this share of a wavelength of the mean frequency over the aperture are one direction. Up to the
# second share they shift each other: with the bins that agree with one source go those of another close to it, and what is
# left of that one points away. There the likelihood of a mixture of both counts.
SEPARATION, RESOLVED = 0.36, 1.3
# Concentration of the phases about those of their source (von Mises), how many of the bins are independent, and steps by which
# the shares of the sources in each cluster are estimated (expectation maximisation).
CONCENTRATION, INDEPENDENT, SHARE_STEPS = 8.0, 0.1, 4
LOG_NORMAL = np.log(np.i0(CONCENTRATION))
# A further source is more probable than chance. To an array, bins that two sources share look like a source at
# another place, alike in many clusters: significance counts by this factor, and sigma by its inverse.
ARRAY_SIGNIFICANCE = 0.6
# Noise differs from one cluster to the next. What a body between two microphones does to a source does not: in neighbouring
# clusters it looks like a source elsewhere. To a pair a source is also significant in wider clusters. As these are fewer, their
# significance counts by this factor.
# At a measured head 0 instead of 2 % of the windows have another confident direction by that.
WIDE_HZ, WIDE_SIGNIFICANCE = 1000.0, 1.65
# Coherent share of all bins that a further source has at least: what a window without noise leaves of its source has less.
LEAST_COHERENCE = 0.03


class FurtherSources(SteeredResponse):
    """Finds sources one by one: bins whose phases agree with those found are left out, the others steered with even weights.

    Two sources rarely have the same bins at the same time (Yilmaz and Rickard, 2004), least so in those of the whole window,
    which are the narrowest.

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the bins.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float) -> None:
        self._group = max(1, round(GROUP_HZ / float(frequencies[1] - frequencies[0])))
        self._used = len(frequencies) // self._group * self._group
        super().__init__(array, frequencies[:self._used].reshape(-1, self._group).mean(axis=1), speed_of_sound, ALIKE_HZ)
        self._least_height = LEAST_COHERENCE * self._used * len(self._baselines.pairs)
        self._significance = 1.0 if array.channels == 2 else ARRAY_SIGNIFICANCE
        _, neighbours = cKDTree(self.grid).query(self.grid, min(len(self.grid), 3**array.rank))
        self._neighbours = np.ascontiguousarray(neighbours[:, 1:].T)
        wavelength = speed_of_sound / (float(frequencies.mean()) * array.aperture)
        self._apart, self._resolved = SEPARATION * wavelength, RESOLVED * wavelength

    def beside(self, spectra: NDArray, peak: Peak, most: int) -> list[Peak]:
        """The peaks of all sources, that of the strongest first: of its two estimates, alone and beside the others, the better.

        Parameters:
            spectra (m, k): spectra of the window.
            peak: the strongest source, estimated alone.
            most: largest number of sources, up to MOST_SOURCES.
        """
        peaks = self.find(spectra, peak.q, most) if most > 1 else []
        if not peaks:
            return [peak]
        apart = peak.q - peaks[0].q  # of two estimates whose errors are alike
        better = min(peak, peaks[0], key=lambda one: float(np.trace(one.covariance + one.bias)))
        return [replace(better, bias=better.bias + 0.5 * np.outer(apart, apart), significance=peak.significance,
                        main_share=max(peak.main_share, peaks[0].main_share), curve=peak.curve),
                *[replace(one, main_share=one.main_share * is_no_reflection(one.height / peaks[0].height, peak.reflected))
                  for one in peaks[1:]]]

    def find(self, spectra: NDArray, strongest: NDArray, most: int) -> list[Peak]:
        """Peaks of all sources, that at `strongest` first; none where it is the only one.

        Parameters:
            spectra (m, k): spectra of the window.
            strongest (rank,): direction q of the strongest source.
            most: largest number of sources, up to MOST_SOURCES.
        """
        phases = self._phases(spectra)
        found, peaks = [strongest], list[Peak]()
        while len(found) < most:
            peak = self._beside(phases, found)
            if peak is None or peak.significance < EVEN_SIGNIFICANCE or peak.height < self._least_height:
                break
            found.append(peak.q)
            refined = [self._again(phases, found, k) for k in range(len(found))]
            if any(one.significance == 0.0 for one in refined):  # one was a part of another: nothing is left of it
                break
            peaks = refined
        beside = [self._beside_others(phases, peak, [other for other in peaks if other is not peak]) for peak in peaks[1:]]
        return peaks[:1] + [peak for peak in beside if peak is not None]

    def _beside_others(self, phases: NDArray, peak: Peak, others: Sequence[Peak]) -> Peak | None:
        """A further source; to a pair that is close to another one, with mean and variance of its place in a mixture of both.

        None where it may be at the other's place: that is one source whose phases scatter, as those of a moving one do.
        To arrays, bins that both have are at neither's place, which their mixture takes for sources.
        """
        near = min(others, key=lambda other: float(np.linalg.norm(peak.q - other.q))).q
        if len(phases) > 1 or np.linalg.norm(peak.q - near) > self._resolved:
            return peak
        places = self.grid[np.linalg.norm(self.grid - near, axis=1) < 1.2 * self._resolved]
        likelihood = self._mixture_likelihoods(phases, near, places)
        weights = np.exp(INDEPENDENT * (likelihood - likelihood.max()))
        weights /= weights.sum()
        mean = weights @ places
        covariance = peak.covariance + (weights * (places - mean).T) @ (places - mean)
        if (mean - near) @ np.linalg.solve(covariance, mean - near) < 1.0:
            return None
        return replace(peak, q=mean, covariance=covariance)

    def _mixture_likelihoods(self, phases: NDArray, first: NDArray, places: NDArray) -> NDArray:
        """Logarithms (q,) of the likelihoods of phases that stem from two directions or from noise, which has any phase.

        Parameters:
            phases (1, n, j): unit phases of the cross-spectra.
            first (rank,): one direction.
            places (q, rank): the other, of each likelihood.
        """
        known = [np.ones(phases.shape[1:], np.float32), self._density(phases, first)]
        return np.array([self._log_mixture(np.stack([*known, self._density(phases, place)])) for place in places])

    def _density(self, phases: NDArray, q: NDArray) -> NDArray:
        """Probability density (n, j) of phases (1, n, j) of a source at q (rank,), relative to that of any phase."""
        steering = np.exp(-1j * (self._slowness @ q).astype(np.float32)[:, None] * self._omega)
        return np.exp(CONCENTRATION * (phases * steering[:, None]).real[0] - LOG_NORMAL)

    def _log_mixture(self, density: NDArray) -> float:
        """Logarithm of the likelihood of a mixture of densities (3, n, j), whose shares in each cluster are estimated."""
        sizes = self._cluster_sizes * self._group
        shares = np.full((len(density), len(sizes)), 1.0 / len(density))
        for step in range(SHARE_STEPS):
            of_groups = np.repeat(shares, self._cluster_sizes, axis=1)
            total = np.einsum('sj,snj->nj', of_groups, density)
            if step < SHARE_STEPS - 1:
                expected = of_groups * np.einsum('snj,nj->sj', density, 1.0 / total)
                shares = np.add.reduceat(expected, self._clusters, axis=1) / sizes
        return float(np.log(total).sum())

    def _peak(self, weighted: NDArray, q: NDArray, curve: NDArray) -> Peak:
        peak = super()._peak(weighted, q, curve)
        return replace(peak, covariance=peak.covariance / self._significance**2)

    def _significance_of(self, parts: NDArray) -> float:
        clusters = parts.sum(axis=0)
        significance = self._significance * over_chance(clusters)
        if self._array.channels > 2:
            return significance
        wide = np.add.reduceat(clusters, np.arange(0, len(clusters), round(WIDE_HZ / ALIKE_HZ)))
        return min(significance, WIDE_SIGNIFICANCE * over_chance(wide))

    def _again(self, phases: NDArray, found: list[NDArray], k: int) -> Peak:
        """The peak of source k without the others, to which its direction is moved."""
        others = found[:k] + found[k + 1:]
        weighted = self._without(phases, others)
        curve = np.where(self._are_apart(others), self.curve(weighted), 0.0)
        peak = self._peak(weighted, self._search(weighted, np.where(self._are_apart([found[k]]), 0.0, curve)), curve)
        found[k] = peak.q
        return peak

    def _phases(self, spectra: NDArray) -> NDArray:
        """Sums (u, n, j) of the unit phases of the cross-spectra of spectra (m, k) by baseline, in j groups of n bins."""
        groups = phases_of(spectra[:, :self._used]).reshape(len(spectra), -1, self._group)
        unit = np.ascontiguousarray(groups.swapaxes(1, 2))
        first, second = self._baselines.pairs.T
        return self._baselines.sum(unit[first] * unit[second].conj())

    def _without(self, phases: NDArray, found: Sequence[NDArray]) -> NDArray:
        """Sum (u, j) of the phases (u, n, j) of bins that agree with none of the directions found.

        Of noise, whose phases are uniform, a pair has left the mean -sin(a) / (pi - n a) exp(j w tau) for each of n directions,
        a being half of the width that is removed: it is added. In noise the phases of several pairs hardly ever agree; but more
        is left of a source where it is weak: that is measured in bands and removed.
        """
        pairs = len(self._baselines.pairs)
        angles = [(self._slowness @ q).astype(np.float32)[:, None] * self._omega for q in found]
        steering = [np.cos(each) + 1j * np.sin(each) for each in angles]
        agreement = [np.einsum('unj,uj->nj', phases, one.conj()).real / pairs for one in steering]
        kept = (phases[0] != 0.0) & np.all(np.less(agreement, np.cos(AGREES_RAD)), axis=0)
        others, count = np.einsum('unj,nj->uj', phases, kept.astype(np.float32)), kept.sum(axis=0)
        for one in steering:
            if pairs == 1:
                share = np.full(len(count), -np.sin(AGREES_RAD) / (np.pi - AGREES_RAD * len(found)))
            else:
                left = np.add.reduceat((others * one.conj()).real.sum(axis=0) / pairs, self._clusters)
                left /= np.maximum(np.add.reduceat(count, self._clusters), 1)
                share = np.repeat(np.maximum(left, 0.0), self._cluster_sizes)
            others -= np.outer(self._baselines.counts, share * count).astype(np.float32) * one
        return others

    def _beside(self, phases: NDArray, found: Sequence[NDArray]) -> Peak | None:
        """The highest peak of phases (u, n, j) at a distance from the directions found, after removing theirs.

        None without a peak.
        """
        weighted = self._without(phases, found)
        curve = self.curve(weighted)
        free = self._are_apart(found)
        tops = free & (curve >= curve[self._neighbours].max(axis=0))    # a slope of those found is none
        if not tops.any():
            return None
        curve = np.where(free, curve, 0.0)
        return self._peak(weighted, self._search(weighted, np.where(tops, curve, 0.0)), curve)

    def _are_apart(self, found: Sequence[NDArray]) -> NDArray:
        """Which points of the grid (g,) are other directions than those found."""
        return np.all([np.linalg.norm(self._axes - q[:, None], axis=0) > self._apart for q in found], axis=0)
