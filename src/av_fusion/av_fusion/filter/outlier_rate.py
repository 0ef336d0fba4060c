"""Estimate of the share of directions of arrival that do not stem from the target, such as persistent reflections."""

from __future__ import annotations

import math

from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.measurement.vectors import Vector, angles, dot

MEMORY_S = 60.0  # time constant of forgetting
PRIOR_S = 3.0  # weight of the prior, in seconds of comparisons
LONGEST_STEP_S = 0.5  # weight of one comparison
TOLERANCE = math.radians(5.0)  # for the array's mounting and the target's motion between two images
PRIOR_OUTLIER = 0.1  # probability of an outlier before a comparison


class OutlierRateEstimator:
    """Estimates the rate of outliers from sightings: the mean of a beta distribution with exponential forgetting.

    Each comparison counts as an outlier by its posterior probability, weighted by the time since the previous one.

    Parameters:
        prior: rate before any comparison; 0 disables outliers.
    """

    def __init__(self, prior: float) -> None:
        self._prior = self._rate = prior
        self._outliers = self._total = 0.0  # s
        self._time = -math.inf

    def rate(self, confidence: float) -> float:
        """Long-run probability of an outlier among directions of arrival of this confidence.

        The confidence gives the probability of clutter in each window; the share of persistent clutter grows with its square.
        """
        return 1.0 - (1.0 - self._rate) * (1.0 - (1.0 - confidence) ** 2) if self._prior > 0.0 else 0.0

    def compare(self, measurement: DoaMeasurement, time: float, seen: Vector) -> None:
        """Update the rate by a direction of arrival and a sighting.

        Parameters:
            measurement: the direction of arrival.
            time (s): capture time of the measurement.
            seen: direction in the body frame in which the camera saw the target at that time.
        """
        seconds = min(abs(time - self._time), LONGEST_STEP_S)
        self._time = time
        miss, variance = _miss(measurement, seen)
        variance += TOLERANCE**2
        density = math.exp(-0.5 * miss * miss / variance) * math.sqrt(math.tau / variance) / len(measurement.hypotheses)
        kept = math.exp(-seconds / MEMORY_S)
        outlier = PRIOR_OUTLIER / (PRIOR_OUTLIER + (1.0 - PRIOR_OUTLIER) * density)  # density is relative to uniform
        self._outliers = kept * self._outliers + seconds * outlier
        self._total = kept * self._total + seconds
        self._rate = (self._prior * PRIOR_S + self._outliers) / (PRIOR_S + self._total)


def _miss(measurement: DoaMeasurement, seen: Vector) -> tuple[float, float]:
    """Angle (rad) between a direction of arrival and a sighting in the body frame, and the variance of the former (rad^2)."""
    cone = measurement.cone
    if cone is not None:
        return cone.angle - math.acos(min(max(dot(cone.axis, seen), -1.0), 1.0)), cone.variance / cone.slope_squared
    azimuth, elevation = angles(seen)
    return min(((math.cos(elevation) * math.remainder(h.azimuth - azimuth, math.tau), h.across_variance)
                for h in measurement.hypotheses), key=lambda pair: abs(pair[0]))
