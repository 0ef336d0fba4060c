"""Where the source of former windows may be: its direction is tracked before it is detected in any single window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_audio.steered_response import MARGIN, Peak

# The grid: of q (a cosine), and of its rate in 1/s, as fast as a rig turns.
STEP = 0.01
RATES = np.linspace(-1.2, 1.2, 13)
# Probability per second that the rate becomes any other, and that the sound comes from anywhere else.
NEW_RATE, NEW_SOURCE = 1.0, 0.03
# Share of what reaches an end of the grid that stays there: the direction of a source turns back, a reflection's may vanish.
KEPT_AT_END = 0.5
JITTER = 0.03  # standard deviation of q after a second, beyond its rate
# In a room neighbouring frequencies and windows have reflections in common: log-likelihoods are steeper than the errors that
# are found, and overlapping windows tell less that is new. Both factors are chosen on simulated halls.
STEEPNESS, NEW = 0.25, 0.5
OUTLIER = 0.1  # probability that the phases of a window tell nothing
LOBE = 0.15  # half-width of a peak in q
CLEAR = 0.95  # share of a peak that is believed whatever was before: another source may have become louder
ODDS = 1.05  # a peak is replaced only where former windows make another direction likelier by this factor


class DirectionMemory:
    """Point-mass filter of the direction of the loudest source and its rate (track before detect).

    In a reverberant room the phases of a window are mostly those of reflections, which change as the source moves, while
    its own stay: over some seconds they add up. Windows overlap, so that their densities count by the share that is new.

    Parameters:
        hop_s (s): time between windows.
        window_s (s): length of a window.
    """

    def __init__(self, hop_s: float, window_s: float) -> None:
        self.grid = np.linspace(-MARGIN, MARGIN, round(2.0 * MARGIN / STEP) + 1)
        self._fraction = NEW * min(1.0, hop_s / window_s)
        self._new_source, self._new_rate = 1.0 - np.exp(-np.array([NEW_SOURCE, NEW_RATE]) * hop_s)
        # what is at each point now was there: between two points, of which linear interpolation takes shares
        places = np.arange(len(self.grid)) - RATES[:, None] * hop_s / STEP
        inside = np.clip(places, 0.0, len(self.grid) - 1.0)
        kept = np.where(places == inside, 1.0, KEPT_AT_END)
        below = np.minimum(inside.astype(int), len(self.grid) - 2)
        self._below = below + np.arange(len(RATES))[:, None] * len(self.grid)
        self._upper = (kept * (inside - below)).astype(np.float32)
        self._lower = kept.astype(np.float32) - self._upper
        apart = (self.grid[:, None] - self.grid) / (JITTER * np.sqrt(hop_s))
        spread = np.exp(-0.5 * apart**2)
        self._spread = (spread / spread.sum(axis=1, keepdims=True)).astype(np.float32)
        self._even = np.float32(1.0 / (len(RATES) * len(self.grid)))
        self.clear()

    def clear(self) -> None:
        """Forget everything: the source may be anywhere."""
        self._density = np.full((len(RATES), len(self.grid)), self._even)

    def density(self, places: NDArray, log_likelihood: NDArray | None) -> NDArray:
        """Probability (n,) of each point of the grid by the phases of one window.

        Parameters:
            places (g,): values of q, rising.
            log_likelihood (g,): of these, relative to the peak; None without a peak.
        """
        if log_likelihood is None:
            return np.full(len(self.grid), 1.0 / len(self.grid))
        log_density = STEEPNESS * np.interp(self.grid, places, log_likelihood)
        density = np.exp(log_density - log_density.max())    # a sharp peak may lie between the points
        return density / density.sum()

    def select(self, peak: Peak, density: NDArray) -> Peak:
        """The peak of a window, or what its density shows where the source of all windows more probably is.

        Parameters:
            peak: the highest peak of the newest window.
            density (n,): see `update`.
        """
        former = self._density.sum(axis=0)
        posterior = np.convolve(self.update(density), np.ones(5), 'same')
        best = np.argmax(posterior)
        likely = self.grid[best]
        if peak.main_share > CLEAR or abs(likely - peak.q[0]) < LOBE:
            return peak
        if former[best] < ODDS * np.interp(peak.q[0], self.grid, former):
            return peak
        weights = np.where(np.abs(self.grid - likely) < LOBE, density, 0.0)
        share = float(weights.sum())
        if share == 0.0:  # the window excludes it
            return peak
        weights /= share
        mean = float(weights @ self.grid)
        return replace(peak, q=np.array([mean]), covariance=np.array([[float(weights @ (self.grid - mean) ** 2)]]),
                       main_share=share)

    def update(self, density: NDArray) -> NDArray:
        """Probability (n,) of each point of the grid, given all windows.

        Parameters:
            density (n,): probability of each point by the newest window alone, one hop after the one before.
        """
        moved = self._density.ravel()
        moved = moved[self._below] * self._lower + moved[self._below + 1] * self._upper
        moved += self._new_rate * (moved.mean(axis=0) - moved)
        likelihood = (1.0 - OUTLIER) * density * len(self.grid) + OUTLIER
        self._density = (1.0 - self._new_source) * (moved @ self._spread) + self._new_source * self._even
        self._density *= (likelihood**self._fraction).astype(np.float32)
        self._density /= self._density.sum()
        return self._density.sum(axis=0)
