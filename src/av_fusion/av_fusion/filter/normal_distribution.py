"""Density and probability of a normal distribution."""

from __future__ import annotations

import math


def gaussian(residual: float, variance: float) -> float:
    """Density of a zero-mean normal distribution.

    Parameters:
        residual: deviation from the mean.
        variance: variance of the distribution.
    """
    return math.exp(-0.5 * residual * residual / variance) / math.sqrt(2.0 * math.pi * variance)


def share_within(half_width: float, offset: float, variance: float) -> float:
    """Probability that a normal variable lies within +-half_width of a point that is `offset` from its mean.

    Parameters:
        half_width (rad): half of the width of the interval.
        offset (rad): centre of the interval minus mean.
        variance (rad^2): variance of the variable.
    """
    scale = math.sqrt(2.0 * variance if variance > 1e-12 else 2e-12)
    return 0.5 * (math.erf((half_width - offset) / scale) + math.erf((half_width + offset) / scale))
