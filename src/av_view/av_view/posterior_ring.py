"""The posterior of the azimuth on a ring of bins, of what a bearing says of it."""

from __future__ import annotations

import math

import numpy as np

BINS = 120
LEAST_SIGMA = math.radians(1.5)  # half a bin: narrower peaks would fall between the bins


def posterior_ring(azimuth: float, variance: float, mirror: float | None, probability: float) -> list[float]:
    """Probability in each of BINS bins from -pi on, relative to the most probable one.

    A mixture of two wrapped normal distributions: the bearing with its probability, and its mirror image with the rest.

    Parameters:
        azimuth (rad): of the bearing.
        variance (rad^2): of the bearing.
        mirror (rad): the mirror image; None without one.
        probability: 0.5..1, that the bearing is in the correct hemisphere.

    Returns nothing for a variance that says nothing.
    """
    if not (math.isfinite(azimuth) and 0.0 <= variance <= math.pi**2):
        return []
    centres = -math.pi + (np.arange(BINS) + 0.5) * math.tau / BINS
    sigma = max(math.sqrt(variance), LEAST_SIGMA)
    share = min(max(probability, 0.5), 1.0) if mirror is not None else 1.0
    density = share * _wrapped_normal(centres - azimuth, sigma)
    if mirror is not None:
        density = density + (1.0 - share) * _wrapped_normal(centres - mirror, sigma)
    return [round(float(value), 3) for value in density / density.max()]


def _wrapped_normal(offset: np.ndarray, sigma: float) -> np.ndarray:
    """Up to a factor; turns beyond the first do not count at standard deviations up to pi."""
    turns = offset[:, None] + math.tau * np.arange(-2, 3)
    return np.exp(-0.5 * (turns / sigma) ** 2).sum(axis=1)
