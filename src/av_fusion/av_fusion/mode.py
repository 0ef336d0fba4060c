"""One mode of the posterior: a Kalman filter of azimuth and its rate in the world, and of elevation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from av_common.angles import wrap


@dataclass
class Mode:
    """A Gaussian over (azimuth, azimuth rate) and, apart from it, elevation; with its weight in the mixture.

    Plain floats, not arrays: a mixture holds a handful of modes, for which scalar arithmetic is ten times faster.
    """

    weight: float
    azimuth: float
    azimuth_variance: float
    rate: float
    rate_variance: float
    covariance: float = 0.0  # of azimuth and rate
    elevation: float = 0.0
    elevation_variance: float = math.inf

    def predict(self, dt: float, acceleration_density: float, elevation_density: float) -> None:
        """Constant rate over `dt` s with white angular acceleration (rad^2/s^3), elevation as a random walk (rad^2/s).

        Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, eq. 6.2.2-12.
        """
        q = acceleration_density
        self.azimuth = float(wrap(self.azimuth + dt * self.rate))
        self.azimuth_variance += dt * (2.0 * self.covariance + dt * self.rate_variance) + q * dt**3 / 3.0
        self.covariance += dt * self.rate_variance + q * dt**2 / 2.0
        self.rate_variance += q * dt
        self.elevation_variance += elevation_density * dt

    def innovation(self, azimuth: float, lag: float) -> float:
        """Measured minus expected azimuth, for a measurement made `lag` s before the mode's time."""
        return float(wrap(azimuth - self.azimuth + lag * self.rate))

    def expected_variance(self, lag: float) -> float:
        """Variance of the azimuth `lag` s before the mode's time."""
        return self.azimuth_variance - 2.0 * lag * self.covariance + lag**2 * self.rate_variance

    def update(self, lag: float, innovations: Sequence[float], variances: Sequence[float], shares: Sequence[float]) -> None:
        """Probabilistic data association (Bar-Shalom and Tse, 1975) of azimuths measured `lag` s ago.

        `innovations` (rad) with `variances` (rad^2) belong to this mode with probabilities `shares`, which may sum to less
        than one: the rest is the chance that none does. The measurement matrix is [1, -lag]: a late measurement counts
        for what it says about the present.
        """
        share = sum(shares)
        if share < 1e-6:
            return
        mean_variance = share / sum(s / v for s, v in zip(shares, variances, strict=True))
        expected = self.expected_variance(lag)
        total = expected + mean_variance
        to_azimuth = self.azimuth_variance - lag * self.covariance
        to_rate = self.covariance - lag * self.rate_variance
        gain_azimuth, gain_rate = to_azimuth / total, to_rate / total
        mean = sum(s * nu for s, nu in zip(shares, innovations, strict=True))
        spread = sum(s * nu * nu for s, nu in zip(shares, innovations, strict=True)) - mean * mean
        shrink = spread - share * total
        self.azimuth = float(wrap(self.azimuth + gain_azimuth * mean))
        self.rate += gain_rate * mean
        self.azimuth_variance += gain_azimuth * gain_azimuth * shrink
        self.covariance += gain_azimuth * gain_rate * shrink
        self.rate_variance += gain_rate * gain_rate * shrink

    def update_elevation(self, elevation: float, variance: float, share: float) -> None:
        """Take in a measured elevation that belongs to this mode with probability `share`."""
        if share < 0.05 or not math.isfinite(variance):
            return
        if not math.isfinite(self.elevation_variance):
            self.elevation, self.elevation_variance = elevation, variance / share
            return
        gain = self.elevation_variance / (self.elevation_variance + variance / share)
        self.elevation += gain * (elevation - self.elevation)
        self.elevation_variance *= 1.0 - gain

    def resembles(self, other: Mode) -> bool:
        """Whether both say the same of azimuth and rate, as far as they know (half a standard deviation)."""
        return (float(wrap(other.azimuth - self.azimuth)) ** 2 < 0.25 * (self.azimuth_variance + other.azimuth_variance)
                and (other.rate - self.rate) ** 2 < self.rate_variance + other.rate_variance)

    def absorb(self, other: Mode) -> None:
        """Merge another mode into this one, keeping the moments of the sum."""
        total = self.weight + other.weight
        a, b = self.weight / total, other.weight / total
        d_azimuth, d_rate = float(wrap(other.azimuth - self.azimuth)), other.rate - self.rate
        self.azimuth = float(wrap(self.azimuth + b * d_azimuth))
        self.rate += b * d_rate
        self.azimuth_variance = a * self.azimuth_variance + b * other.azimuth_variance + a * b * d_azimuth**2
        self.covariance = a * self.covariance + b * other.covariance + a * b * d_azimuth * d_rate
        self.rate_variance = a * self.rate_variance + b * other.rate_variance + a * b * d_rate**2
        if other.elevation_variance < self.elevation_variance:
            self.elevation, self.elevation_variance = other.elevation, other.elevation_variance
        self.weight = total


def gaussian(residual: float, variance: float) -> float:
    """Density of a zero-mean normal distribution."""
    return math.exp(-0.5 * residual * residual / variance) / math.sqrt(2.0 * math.pi * variance)


def share_within(half_width: float, offset: float, variance: float) -> float:
    """Probability that a normal variable lies within +-half_width of a point that is `offset` from its mean."""
    scale = math.sqrt(2.0 * max(variance, 1e-12))
    return 0.5 * (math.erf((half_width - offset) / scale) + math.erf((half_width + offset) / scale))
