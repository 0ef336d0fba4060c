"""What the rig's own noise leaves where a recording whitens it: values of bands by direction, and heights of peaks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_audio.spectra import TINY

# Least standard deviation of the heights of noise over their mean, of which a recording has few windows; and of the values of
# bands over that of the others, where a codec has removed the noise.
LEAST_SPREAD = 0.1
PRIOR_WINDOWS = 10.0  # as which the deviation in all directions counts for each: a recording has some 30, which overlap
ROUNDED = 1e-4  # a p-value this close to 1 is 1: odds are a difference of nearly equal numbers there


class EgoValues(NamedTuple):
    """Values of bands in windows of the rig alone: what whitening by other windows leaves of own noise.

    It is neither white nor even, since each rotor and wheel varies by itself. A source is what differs from it: values less
    their mean, over the deviation of their cluster of bands.

    Parameters:
        mean (b, g): of each band in each direction.
        deviation (b, g): of the sums over clusters of bands.
    """

    mean: NDArray
    deviation: NDArray

    @classmethod
    def of(cls, values: NDArray, starts: NDArray) -> EgoValues:
        """Learn from windows.

        Parameters:
            values (w, b, g): of the windows.
            starts (c,): first bands of the clusters.
        """
        variance = np.add.reduceat(values, starts, axis=1, dtype=float).var(axis=0)
        count, all_directions = len(values), variance.mean(axis=1, keepdims=True)
        shared = (count * variance + PRIOR_WINDOWS * all_directions) / (count + PRIOR_WINDOWS)
        least = LEAST_SPREAD**2 * max(float(shared.mean()), TINY)
        deviation = np.sqrt(np.maximum(shared, least)).repeat(np.diff(starts, append=values.shape[1]), axis=0)
        return cls(values.mean(axis=0, dtype=float).astype(np.float32), deviation.astype(np.float32))

    def beside(self, other: EgoValues) -> EgoValues:
        """Of the windows of both, which are as many."""
        return EgoValues(0.5 * (self.mean + other.mean), np.sqrt(0.5 * (self.deviation**2 + other.deviation**2)))

    def standard(self, values: NDArray) -> NDArray:
        """Standardised values (b, g)."""
        return np.asarray((values - self.mean) / self.deviation)

    def near(self, point: int) -> EgoValues:
        """What it is at a point of the grid."""
        return EgoValues(self.mean[:, point, None], self.deviation[:, point, None])


class EgoPeaks(NamedTuple):
    """Peaks in windows of the rig alone: the highest of each, or the next ones.

    What is left of own noise is neither white nor even: of a pair half of these peaks may lie within a tenth of the cosines,
    the same in each window. A source may be anywhere.

    Parameters:
        mean, deviation: of their heights.
        places (n, rank): where they are.
        grid (g, rank): all directions.
        reach: distance up to which two peaks are at one place.
    """

    mean: float
    deviation: float
    places: NDArray
    grid: NDArray
    reach: float

    @classmethod
    def of(cls, heights: Sequence[float], places: NDArray, grid: NDArray, reach: float) -> EgoPeaks:
        """Learn from peaks.

        Parameters:
            heights (n,): of each window's peak.
            places (n, rank), grid (g, rank), reach: see EgoPeaks.
        """
        mean = float(np.mean(heights))
        return cls(mean, max(float(np.std(heights)), LEAST_SPREAD * mean, TINY), places, grid, reach)

    def is_source(self, height: float, q: NDArray) -> float:
        """Probability that a peak stems from a source and not from the rig alone, of equal prior odds.

        Parameters:
            height: of the peak.
            q (rank,): where it is.
        """
        odds = odds_of(self._beyond(height)) / self._density(q)
        return odds / (1.0 + odds)

    def _beyond(self, height: float) -> float:
        """Probability that the rig alone has a higher peak: maxima have an extreme-value distribution."""
        scale = self.deviation * math.sqrt(6.0) / math.pi
        return -math.expm1(-math.exp(min(-(height - self.mean) / scale - np.euler_gamma, 700.0)))

    def _density(self, q: NDArray) -> float:
        """Density of these peaks at q (rank,) over that of an even distribution, by Laplace's rule: one more at each place."""
        near, all_near = (np.linalg.norm(points - q, axis=1) <= self.reach for points in (self.places, self.grid))
        return float((1.0 + np.sum(near)) / (1.0 + len(near) * np.mean(all_near)))


def odds_of(p: float) -> float:
    """Odds of a source over the rig alone by the p-value of a peak.

    P-values of sources have the density x p^(x - 1), with any x from 0 to 1. The largest such odds, 1 / (-e p ln p), are their
    bound (Sellke, Bayarri and Berger, 2001); these are the mean, which is 1 where there is no source.
    """
    if p >= 1.0 - ROUNDED:
        return 0.5
    p = max(p, TINY)
    log = math.log(p)
    return (1.0 - p + p * log) / (p * log**2)
