"""The blade-pass frequency of a target, by which its sound is told from that of others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.measurements import DoaMeasurement

LOWEST_HZ, HIGHEST_HZ, STEP = 40.0, 1000.0, 0.02
GRID = np.arange(math.log(LOWEST_HZ), math.log(HIGHEST_HZ), STEP)  # of the logarithm of the frequency
WRONG = 0.2  # share of fundamentals that are multiples or parts of the true one, or of another source
DIFFUSION = 0.03**2  # 1/s, of the logarithm: thrust, hence speed, follows the flight
FORGOTTEN_S = 100.0  # time constant with which nothing is known
TYPE_SIGMA = 0.08  # of the logarithm, of drones of one type: load and flight differ


def fundamental_likelihoods(measurements: Sequence[DoaMeasurement]) -> NDArray[np.float64]:
    """Likelihood of each measured fundamental over the grid, relative to any frequency being as likely, (m, k)."""
    known = np.array([(one.fundamental, one.fundamental_variance) for one in measurements]).reshape(-1, 2)
    usable = (known[:, 0] >= LOWEST_HZ) & (known[:, 0] <= HIGHEST_HZ) & (known[:, 1] >= 0.0) & np.isfinite(known[:, 1])
    likelihoods = np.ones((len(known), len(GRID)))
    frequency, variance = known[usable, :1], known[usable, 1:]
    sigma = np.clip(np.sqrt(variance) / frequency, STEP, 1.0)
    density = np.exp(-0.5 * ((np.log(frequency) - GRID) / sigma) ** 2) / (math.sqrt(math.tau) * sigma)
    likelihoods[usable] = WRONG + (1.0 - WRONG) * density * len(GRID) * STEP
    return likelihoods


class BladePassFrequency:
    """A density over a grid of frequencies: a comb of harmonics may fit twice or half the frequency as well as the true one."""

    def __init__(self) -> None:
        self._density = np.full(len(GRID), 1.0 / len(GRID))
        self._measured = False

    @property
    def frequency(self) -> float:
        """The most probable frequency (Hz); NaN before the first measurement."""
        return float(np.exp(GRID[self._density.argmax()])) if self._measured else math.nan

    def predict(self, seconds: float) -> None:
        """Predict by `seconds`."""
        if self._measured and seconds > 0.0:
            kept = math.exp(-seconds / FORGOTTEN_S)
            sigma = math.sqrt(DIFFUSION * seconds) / STEP
            reach = min(round(4.0 * sigma), len(GRID) // 2)
            spread = np.convolve(self._density, np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2), 'same')
            self._density = kept * spread / np.add.reduce(spread) + (1.0 - kept) / len(GRID)

    def fits(self, likelihoods: NDArray[np.float64]) -> NDArray[np.float64]:
        """Likelihood (m,) of each measurement under this density, relative to any frequency; see `fundamental_likelihoods`."""
        return np.asarray(likelihoods @ self._density)

    def update(self, likelihoods: NDArray[np.float64], shares: NDArray[np.float64], fraction: float) -> None:
        """Update by the measurements of one window.

        Parameters:
            likelihoods (m, k): see `fundamental_likelihoods`.
            shares (m,): probability of each that it stems from this target; they sum to at most one.
            fraction: effective sample fraction, as windows overlap.
        """
        tempered = likelihoods**fraction
        posteriors = self._density * tempered / self.fits(tempered)[:, None]
        self._density = (1.0 - np.add.reduce(shares)) * self._density + shares @ posteriors
        self._density /= np.add.reduce(self._density)
        self._measured = self._measured or bool(np.logical_or.reduce((shares > 0.5) & (likelihoods[:, 0] != 1.0)))

    def type_of(self, types: Mapping[str, float]) -> str:
        """The most probable type of drone; empty where none is more probable than not.

        Parameters:
            types: blade-pass frequency in Hz of each known type.
        """
        if not types or not self._measured:
            return ''
        width = len(GRID) * STEP  # all types, and that it is another one, are equally probable before
        odds = {name: width * float(self._density @ np.exp(-0.5 * ((GRID - math.log(hz)) / TYPE_SIGMA) ** 2)
                                    / (math.sqrt(math.tau) * TYPE_SIGMA)) for name, hz in types.items()}
        best = max(odds, key=odds.__getitem__)
        return best if 2.0 * odds[best] >= 1.0 + sum(odds.values()) else ''
