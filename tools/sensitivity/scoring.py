"""The score of a density at the truth."""

from __future__ import annotations

import math

SOMEWHERE = 1.0 / math.tau  # density of a direction that may be any
UNMODELLED = 0.02  # share of what no estimate expects, so that a score stays finite


def score_of(density: float) -> float:
    """Logarithm of the density of an azimuth (1/rad) at the truth (Good, Rational decisions, 1952)."""
    return math.log(UNMODELLED * SOMEWHERE + (1.0 - UNMODELLED) * density)
