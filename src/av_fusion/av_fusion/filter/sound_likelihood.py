"""What was heard, as a measurement: how well a mode explains it, and what it says of that mode."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import remainder, tau

from av_fusion.filter.gaussian_component import Mode

Comparison = tuple[Mode, tuple[float, float, float], float, float, float]
"""A mode with a sound: the mode, measurement row, variance of the innovation, innovation, and how well both fit.

The fit is the likelihood over that of a mode that knew exactly what was measured: 1 at best.
"""


class MirrorImages:
    """Two mirror images, `half` to either side of an axis (world azimuth): one measurement, the cosine of that angle."""

    def __init__(self, azimuths: Sequence[float], variances: Sequence[float]) -> None:
        self.half = 0.5 * remainder(azimuths[1] - azimuths[0], tau)
        self.axis = azimuths[0] + self.half
        self._cosine = math.cos(self.half)
        self._noise = variances[0] * max(abs(math.sin(self.half)), 0.05) ** 2  # d cos / d azimuth where it was measured

    def compare(self, mode: Mode, lag: float) -> Comparison:
        """With what a mode was `lag` s ago."""
        mean, variance, row = mode.expected_cosine(self.axis, lag)
        innovation, total = self._cosine - mean, variance + self._noise
        return mode, row, total, innovation, _fit(innovation, total, self._noise)


class Directions:
    """Any other number of hypotheses: world azimuths, of which the one nearest to a mode counts."""

    def __init__(self, azimuths: Sequence[float], variances: Sequence[float]) -> None:
        self._azimuths, self._variances = azimuths, variances

    def compare(self, mode: Mode, lag: float) -> Comparison:
        """With what a mode was `lag` s ago."""
        innovation, noise = min(((mode.innovation(azimuth, lag), variance)
                                 for azimuth, variance in zip(self._azimuths, self._variances, strict=True)),
                                key=lambda pair: abs(pair[0]))
        total = mode.expected_variance(lag) + noise
        return mode, (1.0, -lag, 0.0), total, innovation, _fit(innovation, total, noise)


def _fit(innovation: float, total: float, noise: float) -> float:
    return math.exp(-0.5 * innovation * innovation / total) * math.sqrt(noise / total)
