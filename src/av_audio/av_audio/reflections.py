"""Reflections from elsewhere, which an array does not resolve from their source: they pull its direction towards theirs.

They do so at all frequencies and to all pairs alike, so that no scatter tells it: a line of five microphones, to which noise
leaves 0.5 deg, errs by 2 deg in rooms.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_audio.baselines import Baselines
from av_audio.steered_response import direction_grid
from av_common.microphone_array import MicrophoneArray

# The field of a room is as uneven as that of this number of equal reflections from anywhere: one from each of its sides.
WALLS = 6
# Directions of reflections: cosines to a line, or points per unit of a sphere (113 in all).
COSINES: NDArray = np.linspace(-1.0, 1.0, 41)[:, None]
POINTS_PER_UNIT = 3.0


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
        self._from = COSINES if array.rank == 1 else direction_grid(3, POINTS_PER_UNIT) @ array.basis

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
