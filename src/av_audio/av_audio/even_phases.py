"""Phases with equal weights, at several resolutions in time: robust where reflections contradict a likelihood.

Reflections that an array does not resolve from their source pull its direction towards theirs, at all frequencies and to all
pairs alike, so that no scatter tells it: a line of five microphones, to which noise leaves 0.5 deg, errs by 2 deg in rooms.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import i0e

from av_audio.baselines import Baselines
from av_audio.spectra import ALIKE_HZ, TINY, Blocks, phases_of
from av_audio.steered_response import Peak, SteeredResponse, direction_grid
from av_common.microphone_array import MicrophoneArray

# Lengths of the blocks beside the whole window. Reverberation fills short blocks unevenly, so that some have more direct sound;
# long ones have more signal for their noise. No single length is best in all rooms.
BLOCKS_S = (0.016, 0.032)
# Bins of the whole window that are summed, within which the phase of a delay hardly changes: by 3 deg for 0.2 m.
GROUP_HZ = 16.0
# Width over which the spectrum is made white before it is cut: strong frequencies would leak into weak ones, as those of wind.
WHITENING_HZ = 100.0
# Mean square error of q by reflections where bands do not agree at all; fitted to random rooms.
REFLECTED = 2.0
# At which the exponent of a tail is sought, times where it is for many: a step of 9 % to either side costs less than 1 % of it.
TILTS: NDArray = 2.0 ** np.arange(0.0, 8.0, 0.25)
# The field of a room is as uneven as that of this number of equal reflections from anywhere: one from each of its sides.
WALLS = 6
POINTS_PER_UNIT = 3.0  # of directions of reflections on a sphere, 113 in all


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
        super().__init__(array, everything[self._order], speed_of_sound, ALIKE_HZ)
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

    def _peak(self, weighted: NDArray, q: NDArray, curve: NDArray) -> Peak:
        peak = super()._peak(weighted, q, curve)
        return replace(peak, curve=np.stack([self.grid[:, 0], curve])) if len(q) == 1 else peak

    def _reflections(self, clusters: NDArray, height: float, inverse: NDArray) -> NDArray:
        agreement = height / float(np.abs(clusters).sum())
        return REFLECTED * (1.0 - agreement) ** 4 * np.eye(len(inverse))

    def _rarity(self, clusters: NDArray) -> float:
        """Quantile of the normal distribution that is as rare as a peak of these clusters (c,), as steered, by chance.

        Their phases are even then: the probability that real parts add up to h falls as exp(-max_t(t h - sum log I0(t |c|)))
        (Chernoff, 1952). Where many hardly agree this is the height over its standard deviation. The few wide clusters of a
        source in a narrow band, as of a drone far away, agree by chance much more rarely than a normal distribution states.
        """
        sizes, height = np.abs(clusters).astype(float), float(clusters.real.sum())
        if height <= 0.0:
            return 0.0
        tilts = 2.0 * height / float(sizes @ sizes) * TILTS
        exponents = tilts * height - np.sum(np.outer(tilts, sizes) + np.log(i0e(np.outer(tilts, sizes))), axis=1)
        return math.sqrt(2.0 * max(0.0, float(exponents.max())))

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


class Reflections:
    """Power of what is reflected, over that of what arrives directly, and how far it moves a peak.

    A microphone i has the spectrum X_i = S (1 + e_i) + N_i; e_i are reflections of power r, circular, alike at neighbouring
    frequencies (Schroeder, 1962), and independent between microphones more than half a wavelength apart (Cook et al., 1955).
    With P = X_i X_j*, steered to the source, E[P(f) P*(f + df)] = (1 + r)^2 |S|^4 and E[P(f) P(f + df)] = |S|^4, as noise at
    two frequencies is independent. Their ratio gives r without that of noise; phases alone serve as well.

    A peak is where the slopes of the source and of each reflection cancel. One of power r from q' moves that of the source at q
    by r H^-1 sum c w s sin(w s . (q' - q)), c being the coherences with the slownesses s, and H the negative Hessian.

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the window's bins.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float) -> None:
        self._baselines = Baselines(array)
        self._omega = (2.0 * np.pi * frequencies).astype(np.float32)
        self._places = array.positions @ array.basis / speed_of_sound  # (m, rank)
        self._slowness = (self._baselines.vectors @ array.basis / speed_of_sound).astype(np.float32)  # (u, rank)
        first, second = array.positions[self._baselines.pairs.T]
        # Pairs from the bin on at which half a wavelength is less; of a small array, as far as it reaches.
        delays = np.linalg.norm(first - second, axis=1) / speed_of_sound
        least = min(np.pi, 0.5 * float(delays.max() * self._omega[-1])) / delays
        begins = np.searchsorted(self._omega[1:], least, side='right').tolist()
        self._apart = list(zip(*self._baselines.pairs.T.tolist(), begins, strict=True))
        products = len(begins) * (len(frequencies) - 1) - sum(begins)
        self._by_chance = math.sqrt(0.5 * products)  # of the sum of so many products of any phase
        self._from = direction_grid(3, POINTS_PER_UNIT) @ array.basis

    def ratio(self, phases: NDArray, q: NDArray) -> float:
        """Reflected over direct power in spectra of phases (m, k) of a source at q (rank,)."""
        angles = (self._places @ q).astype(np.float32)[:, None] * self._omega
        steered = phases * (np.cos(angles) - 1j * np.sin(angles))
        rising, adding = steered[:, 1:] * steered[:, :-1].conj(), steered[:, 1:] * steered[:, :-1]  # of neighbouring bins
        whole = sum(np.vdot(rising[j, begin:], rising[i, begin:]).real for i, j, begin in self._apart)
        direct = sum(np.vdot(adding[j, begin:], adding[i, begin:]).real for i, j, begin in self._apart)
        return max(0.0, math.sqrt(max(0.0, float(whole)) / max(float(direct), self._by_chance)) - 1.0)

    def pull(self, coherence: NDArray, omega: NDArray, hessian: NDArray, q: NDArray) -> NDArray:
        """Mean square (rank, rank) of the shift of q (rank,) by reflections as strong as their source, from anywhere.

        The mean of the shift is counted and not removed from q: to the phases, a head between the microphones looks alike.

        Parameters:
            coherence (u, c): steered cross-spectra by baseline and band, real parts.
            omega (c,) (rad/s): of the bands.
            hessian (rank, rank): negative Hessian of their sum.
            q (rank,): the peak.
        """
        delays = ((self._from - q) @ self._slowness.T).astype(np.float32)
        slopes = np.einsum('guc,uc->gu', np.sin(delays[..., None] * omega), coherence * omega) @ self._slowness
        shifts = np.linalg.solve(hessian, slopes.T)
        mean = shifts.mean(axis=1)
        return np.outer(mean, mean) + np.atleast_2d(np.cov(shifts, bias=True)) / WALLS


def is_no_reflection(power: float, reflected: float) -> float:
    """Probability that none of a room's reflections is as strong as a further source: of so many, each of exponential power.

    Parameters:
        power: of the further source, over that of the strongest.
        reflected: of all reflections, over that of the strongest's direct sound.
    """
    return (1.0 - math.exp(-WALLS * power / reflected)) ** WALLS if reflected > 0.0 else 1.0
