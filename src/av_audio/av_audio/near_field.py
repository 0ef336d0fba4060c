"""Sound from within half a metre of the microphones, as the rig's own rotors are: where it arrives earlier it is louder, too.

A wave from a distance r reaches one microphone at a path that is shorter by d than that to another, with an amplitude that
is larger by d / r in its logarithm. A target is far: its paths differ, its levels do not. Between the frequencies of a window,
which belong to different rotors, levels therefore rise with paths, by 1 / r.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.spectra import ALIKE_HZ, TINY
from av_common.microphone_array import MicrophoneArray

SNAPSHOTS = 4  # bins of a covariance: as few as tell coherence, since lines of rotors lie side by side
# Above this phase between two microphones, of a source on their axis, paths are ambiguous more often than not.
HIGHEST_PHASE = 1.5 * math.pi
# Responses of microphones differ by this much (0.2 dB) from band to band.
RESPONSE = 0.02
# Least incoherent share of the power: what coherent sources leave to each other.
INCOHERENT = 0.05
# Width of clusters of bands between which errors are independent: responses of rooms with a T60 above 0.3 s change within.
CLUSTER_HZ = 40.0
# Rotors are between these distances from the microphones of a rig, evenly in the logarithm.
NEAREST_M, FARTHEST_M = 0.15, 0.5
OWN = 0.01  # probability that sound of the rig is heard at all; its share of all sound is then even
# Slopes (1/m) that own sound at a distance r with a share s of the power gives, s / r, with their prior densities: where it is
# the louder half, and where it is not.
SLOPES: NDArray = np.linspace(0.0, 1.0 / NEAREST_M, 101)[1:]
_DENSITIES = np.maximum([np.minimum(FARTHEST_M, 1.0 / SLOPES) - np.maximum(NEAREST_M, 0.5 / SLOPES),
                         np.minimum(FARTHEST_M, 0.5 / SLOPES) - NEAREST_M], 0.0)
LOUD, QUIET = OWN * _DENSITIES / _DENSITIES.sum()


class NearField:
    """Compares the levels of pairs of microphones with the paths that their phases state.

    Parameters:
        array: the microphones; with a delay curve nothing is compared, as the body between them shades sound from afar, too.
        frequencies (k,) (Hz): of the bins.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float) -> None:
        bin_hz = float(frequencies[1] - frequencies[0])
        distances = np.linalg.norm(array.baselines, axis=1)
        highest_hz = HIGHEST_PHASE * speed_of_sound / (2.0 * np.pi * distances)
        self._bands = int(np.count_nonzero(frequencies < highest_hz.max())) // SNAPSHOTS
        self._alike, self._cluster = (max(1, round(width / (SNAPSHOTS * bin_hz))) for width in (ALIKE_HZ, CLUSTER_HZ))
        self._usable = array.delay_curve is None and self._bands > self._alike > 2
        centres = frequencies[:self._bands * SNAPSHOTS].reshape(self._bands, SNAPSHOTS).mean(axis=1)
        self._pairs, self._distances = array.pairs, distances[:, None]
        self._inside = centres < highest_hz[:, None]
        self._wavenumber = 2.0 * np.pi * centres / speed_of_sound

    def probability(self, spectra: NDArray) -> float:
        """Probability that sound of the rig itself is the loudest, from spectra (m, k)."""
        if not self._usable:
            return 0.0
        blocks = spectra[:, :self._bands * SNAPSHOTS].reshape(len(spectra), self._bands, SNAPSHOTS)
        powers = np.maximum(np.einsum('mbn,mbn->mb', blocks, blocks.conj()).real, TINY)
        first, second = self._pairs.T
        cross: NDArray = np.einsum('pbn,pbn->pb', blocks[first], blocks[second].conj())
        coherence = np.minimum(np.abs(cross) ** 2 / powers[first] / powers[second], 1.0)
        levels = 0.5 * (np.log(powers[first]) - np.log(powers[second]))
        paths, possible = self._paths(np.arctan2(cross.imag, cross.real))
        slope, sigma = self._slope(levels, paths, coherence / (1.0 - coherence + INCOHERENT) * possible)
        return _is_loud(slope, sigma)

    def _paths(self, phases: NDArray) -> tuple[NDArray, NDArray]:
        """Mean (p, b) (m) of the differences of paths that phases (p, b) admit, and whether there are any."""
        turns = np.array([-1.0, 0.0, 1.0])[:, None, None]
        paths = (phases + 2.0 * np.pi * turns) / self._wavenumber
        admitted = (np.abs(paths) <= 1.1 * self._distances) & self._inside
        count = admitted.sum(axis=0)
        return np.sum(paths * admitted, axis=0) / np.maximum(count, 1), count > 0

    def _slope(self, levels: NDArray, paths: NDArray, weights: NDArray) -> tuple[float, float]:
        """Rise of levels with paths in 1/m by weighted least squares, and its deviation by the clusters' scatter (White, 1980).

        Parameters:
            levels (p, b): logarithms of ratios of amplitudes.
            paths (p, b) (m): differences of paths.
            weights (p, b): of both.
        """
        total = np.maximum(uniform_filter1d(weights, self._alike), 1e-6)  # above what running sums round
        levels, paths = (values - uniform_filter1d(weights * values, self._alike) / total for values in (levels, paths))
        information = float(np.sum(weights * paths**2))
        if information <= TINY:  # a dead channel, or a single direction in all bands
            return 0.0, math.inf
        slope = float(np.sum(weights * paths * levels)) / information
        bands = np.sum(weights * paths * (levels - slope * paths), axis=0)
        scores = np.add.reduceat(bands, np.arange(0, self._bands, self._cluster))
        responses = RESPONSE**2 * float(np.sum((weights * paths) ** 2))
        return slope, math.sqrt(float(scores @ scores) + responses) / information


def _is_loud(slope: float, sigma: float) -> float:
    """Probability that own sound is louder than all other, as far as the window says more than the prior.

    Parameters:
        slope (1/m): rise of levels with paths.
        sigma (1/m): its deviation.
    """
    misfit = np.square((slope - np.append(SLOPES, 0.0)) / sigma)
    likelihood = np.exp(-0.5 * (misfit - misfit.min()))
    loud, quiet = LOUD @ likelihood[:-1], QUIET @ likelihood[:-1]
    posterior, prior = loud / (loud + quiet + (1.0 - OWN) * likelihood[-1]), LOUD.sum()
    return max(0.0, float((posterior - prior) / (1.0 - prior)))
