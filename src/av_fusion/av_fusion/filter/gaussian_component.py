"""A component of the posterior: a Gaussian of azimuth and azimuth rate in the world, and of elevation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import remainder, tau
from typing import NamedTuple

PASSING_S = 1.0  # correlation time of the acceleration of a target that passes by
OCCLUSION_S = 5.0  # time constant of changes of fog
LEAST_ASSOCIATION, LEAST_ELEVATION_ASSOCIATION = 1e-6, 0.05  # probabilities below which a measurement is not used
ASSOCIATED = 0.5  # probability from which a measurement counts as associated with a component


class MotionModel(NamedTuple):
    """Motion of targets as seen from the rig.

    Parameters:
        acceleration_density (rad^2/s^3): spectral density of the azimuth's acceleration.
        elevation_density (rad^2/s): diffusion of the elevation.
        usual_elevation (rad), usual_elevation_variance (rad^2): its stationary distribution.
    """

    acceleration_density: float
    elevation_density: float
    usual_elevation: float
    usual_elevation_variance: float


@dataclass(eq=False, slots=True)
class GaussianComponent:
    """A Gaussian over azimuth a, azimuth rate r and elevation e, with its weight in the mixture.

    Plain floats, not arrays: a mixture holds a few components, for which scalar arithmetic is ten times faster.

    Parameters:
        weight: probability of the component.
        azimuth (rad), azimuth_variance (rad^2): azimuth in the world and its variance.
        rate (rad/s), rate_variance (rad^2/s^2): rate of the azimuth and its variance.
        elevation (rad), elevation_variance (rad^2): elevation and its variance.
        ar (rad^2/s), ae (rad^2), re (rad^2/s): covariances of azimuth and rate, azimuth and elevation, rate and elevation.
        elevation_measured: whether a measurement has updated the elevation, or the motion model alone.
        p_hidden: probability that fog hides the target from the camera.
        hidden_time (s): time for which p_hidden is valid.
        p_outlier: probability that the direction of arrival does not stem from this target.
        newest_doa, newest_sighting (s): capture times of the newest direction of arrival, and of the newest image with a
            detection, that is associated with the component: more probably than not it stems from this target.
    """

    weight: float
    azimuth: float
    azimuth_variance: float
    rate: float
    rate_variance: float
    elevation: float = 0.0
    elevation_variance: float = 0.03
    ar: float = 0.0
    ae: float = 0.0
    re: float = 0.0
    elevation_measured: bool = False
    p_hidden: float = 0.0
    hidden_time: float = -math.inf
    p_outlier: float = 0.0
    newest_doa: float = -math.inf
    newest_sighting: float = -math.inf

    @property
    def measured(self) -> float:
        """Capture time (s) of the newest measurement that is associated with the component."""
        return max(self.newest_doa, self.newest_sighting)

    def predict(self, dt: float, model: MotionModel, noise_scale: float) -> None:
        """Predict by `dt` s: white angular acceleration of `noise_scale` times the model's density.

        The elevation is an Ornstein-Uhlenbeck process. A target that passes by at constant speed accelerates on the circle
        by up to its squared rate, and its elevation changes the faster the higher it is.

        Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, eq. 6.2.2-12.

        Parameters:
            dt (s): duration of the prediction.
            model: motion of targets.
            noise_scale: factor of the acceleration density.
        """
        passing = min(self.rate * self.rate, 0.5)
        q = noise_scale * model.acceleration_density + PASSING_S * passing * passing
        diffusion = model.elevation_density + PASSING_S * passing * math.sin(self.elevation) ** 2
        kept = math.exp(-0.5 * dt * model.elevation_density / model.usual_elevation_variance)
        self.azimuth = remainder(self.azimuth + dt * self.rate, tau)
        self.azimuth_variance += dt * (2.0 * self.ar + dt * self.rate_variance) + q * dt**3 / 3.0
        self.ar += dt * self.rate_variance + q * dt**2 / 2.0
        self.rate_variance += q * dt
        self.ae = kept * (self.ae + dt * self.re)
        self.re *= kept
        self.elevation = model.usual_elevation + kept * (self.elevation - model.usual_elevation)
        self.elevation_variance = (kept**2 * self.elevation_variance
                                   + (1.0 - kept**2) * model.usual_elevation_variance
                                   + (diffusion - model.elevation_density) * dt)

    def predicted(self, ahead: float, model: MotionModel, noise_scale: float) -> GaussianComponent:
        """A copy, valid `ahead` s later. For an earlier time the state is extrapolated back without process noise.

        Parameters:
            ahead (s): time of the copy minus time of the component.
            model: motion of targets.
            noise_scale: factor of the acceleration density.
        """
        copy = replace(self)
        if ahead > 0.0:
            copy.predict(ahead, model, noise_scale)
        else:
            copy.azimuth = remainder(self.azimuth + ahead * self.rate, tau)
            copy.azimuth_variance = self.expected_variance(-ahead)
        return copy

    def innovation(self, azimuth: float, lag: float) -> float:
        """Measured minus predicted azimuth (rad).

        Parameters:
            azimuth (rad): measured azimuth in the world.
            lag (s): time of the component minus time of the measurement.
        """
        return remainder(azimuth - self.azimuth + lag * self.rate, tau)

    def expected_variance(self, lag: float) -> float:
        """Variance of the azimuth (rad^2) `lag` s before the component's time."""
        return self.azimuth_variance - 2.0 * lag * self.ar + lag**2 * self.rate_variance

    def gates(self, azimuth: float, variance: float, lag: float) -> bool:
        """Whether an azimuth measured `lag` s ago is within three standard deviations.

        Parameters:
            azimuth (rad), variance (rad^2): measured azimuth in the world and its variance.
            lag (s): time of the component minus time of the measurement.
        """
        return self.innovation(azimuth, lag) ** 2 < 9.0 * (self.expected_variance(lag) + variance)

    def expected_cosine(self, axis: float, lag: float) -> tuple[float, float, tuple[float, float, float]]:
        """The cosine of the angle between the target and a horizontal axis (world azimuth), `lag` s ago.

        Returns its mean, its variance without the sensor's noise, and the measurement row.

        A linear array measures cos(d) cos(e), with d the azimuth from its axis. For Gaussian d and e, mean, variance and mean
        gradient follow in closed form from E cos x = cos(m) exp(-v/2); by Stein's lemma the covariance with the state is its
        covariance matrix times the mean gradient (Sarkka, Bayesian Filtering and Smoothing, 2013, eq. 6.3). Exact moments
        need no bounds where the cosine is flat, at end-fire.

        Parameters:
            axis (rad): azimuth of the axis in the world.
            lag (s): time of the component minus time of the measurement.
        """
        d, e = -self.innovation(axis, lag), self.elevation
        vd, ve, c = self.expected_variance(lag), self.elevation_variance, self.ae - lag * self.re
        fade_sum, fade_difference = math.exp(-0.5 * (vd + ve) - c), math.exp(-0.5 * (vd + ve) + c)
        sum_cos, sum_sin = fade_sum * math.cos(d + e), fade_sum * math.sin(d + e)
        difference_cos, difference_sin = fade_difference * math.cos(d - e), fade_difference * math.sin(d - e)
        mean = 0.5 * (sum_cos + difference_cos)
        square = 0.25 * (1.0 + math.exp(-2.0 * vd) * math.cos(2.0 * d) + math.exp(-2.0 * ve) * math.cos(2.0 * e)
                         + 0.5 * math.exp(-2.0 * (vd + ve) - 4.0 * c) * math.cos(2.0 * (d + e))
                         + 0.5 * math.exp(-2.0 * (vd + ve) + 4.0 * c) * math.cos(2.0 * (d - e)))
        to_azimuth = -0.5 * (sum_sin + difference_sin)
        return (mean, max(square - mean * mean, 1e-12),
                (to_azimuth, -lag * to_azimuth, -0.5 * (sum_sin - difference_sin)))

    def update(self, row: tuple[float, float, float], total: float, innovation: float, share: float) -> None:
        """Update by a scalar measurement.

        Parameters:
            row: measurement row, the derivatives with respect to azimuth, rate and elevation.
            total: variance of the innovation.
            innovation: measured minus predicted value.
            share: probability that the measurement belongs to this component.
        """
        if share >= LEAST_ASSOCIATION:
            mean = share * innovation
            self._shift(row, total, mean, mean * innovation - mean * mean - share * total)

    def _shift(self, row: tuple[float, float, float], total: float, change: float, variance_change: float) -> None:
        """Change mean and variance of the quantity that `row` measures (variance `total`), and of correlated quantities."""
        h_a, h_r, h_e = row
        g_a = (h_a * self.azimuth_variance + h_r * self.ar + h_e * self.ae) / total
        g_r = (h_a * self.ar + h_r * self.rate_variance + h_e * self.re) / total
        g_e = (h_a * self.ae + h_r * self.re + h_e * self.elevation_variance) / total
        self.azimuth = remainder(self.azimuth + g_a * change, tau)
        self.rate += g_r * change
        self.elevation += g_e * change
        self.azimuth_variance += g_a * g_a * variance_change
        self.rate_variance += g_r * g_r * variance_change
        self.elevation_variance += g_e * g_e * variance_change
        self.ar += g_a * g_r * variance_change
        self.ae += g_a * g_e * variance_change
        self.re += g_r * g_e * variance_change

    def missed_detection(self, time: float, visibility: float, chance: float, fraction: float) -> float:
        """Probability that an image does not show the target.

        Fog changes slowly, over OCCLUSION_S. It hides the target in successive images, so that a hundred images in fog are
        hardly more evidence than one.

        Parameters:
            time (s): capture time of the image.
            visibility: visibility of the image, 0..1.
            chance: probability that a target that is not hidden is in view and detected.
            fraction: effective sample fraction of the image.
        """
        fog, kept = 1.0 - visibility, 1.0
        if time > self.hidden_time:
            kept, self.hidden_time = math.exp((self.hidden_time - time) / OCCLUSION_S), time
        self.p_hidden = fog + kept * (self.p_hidden - fog) if self.p_hidden > fog else fog
        missed = self.p_hidden + (1.0 - self.p_hidden) * (1.0 - chance)
        overlooked = max(1.0 - chance, 1e-3) ** fraction
        self.p_hidden /= max(self.p_hidden + (1.0 - self.p_hidden) * overlooked, 1e-9)
        return missed

    def split(self, axis: float, lag: float) -> list[GaussianComponent]:
        """The component split in two if it extends to both sides of an axis (world azimuth) `lag` s ago, else alone.

        A measurement of a target near end-fire fits both sides, which one Gaussian cannot represent. The parts are truncated
        normal distributions, approximated by Gaussians.

        Parameters:
            axis (rad): azimuth of the axis in the world.
            lag (s): time of the component minus time of the measurement.
        """
        offset, variance = -self.innovation(axis, lag), self.expected_variance(lag)
        sigma = math.sqrt(variance)
        if abs(math.sin(offset)) > 1.3 * sigma:  # less than a tenth beyond the axis
            return [self]
        if math.cos(offset) < 0.0:
            offset = remainder(offset + math.pi, tau)  # the other end of the axis is nearer
        parts = []
        for side in (1.0, -1.0):
            start = side * offset / sigma
            inside = 0.5 * math.erfc(-start / math.sqrt(2.0))
            pull = math.exp(-0.5 * start * start) / math.sqrt(2.0 * math.pi) / inside
            part = replace(self, weight=self.weight * inside)
            part._shift((1.0, -lag, 0.0), variance, side * sigma * pull, -variance * pull * (pull + start))
            parts.append(part)
        return parts

    def update_azimuth(self, lag: float, innovations: Sequence[float], variances: Sequence[float],
                       shares: Sequence[float]) -> None:
        """Update by alternative azimuths, by probabilistic data association (Bar-Shalom and Tse, 1975).

        Parameters:
            lag (s): time of the component minus time of the measurement.
            innovations (rad): measured minus predicted azimuths.
            variances (rad^2): variances of the measured azimuths.
            shares: probabilities that the azimuths belong to this component; the rest to 1 is the probability that none does.
        """
        share = mean = square = information = 0.0
        for s, nu, variance in zip(shares, innovations, variances, strict=True):
            share, mean, square = share + s, mean + s * nu, square + s * nu * nu
            information += s / variance
        if share >= LEAST_ASSOCIATION:
            total = self.expected_variance(lag) + share / information
            self._shift((1.0, -lag, 0.0), total, mean, square - mean * mean - share * total)

    def update_elevation(self, elevation: float, variance: float, share: float) -> None:
        """Update by a measured elevation.

        Parameters:
            elevation (rad), variance (rad^2): measured value and its variance.
            share: probability that the measurement belongs to this component.
        """
        if share > LEAST_ELEVATION_ASSOCIATION and math.isfinite(elevation) and 0.0 < variance < math.inf:
            self.update((0.0, 0.0, 1.0), self.elevation_variance + variance, elevation - self.elevation, share)
            self.elevation_measured = True

    def is_mergeable(self, other: GaussianComponent) -> bool:
        """Whether azimuth and rate of both agree within their standard deviations, so that their sum has one peak."""
        return (remainder(other.azimuth - self.azimuth, tau) ** 2 < (self.azimuth_variance + other.azimuth_variance)
                and (other.rate - self.rate) ** 2 < self.rate_variance + other.rate_variance)

    def merge(self, other: GaussianComponent) -> None:
        """Merge another component into this one, preserving the moments of the sum; the heavier one's support is kept."""
        if other.weight > self.weight:
            self.newest_doa, self.newest_sighting = other.newest_doa, other.newest_sighting
        total = self.weight + other.weight
        a, b = self.weight / total, other.weight / total
        d_azimuth, d_rate = remainder(other.azimuth - self.azimuth, tau), other.rate - self.rate
        d_elevation = other.elevation - self.elevation
        self.azimuth = remainder(self.azimuth + b * d_azimuth, tau)
        self.rate += b * d_rate
        self.elevation += b * d_elevation
        self.azimuth_variance = a * self.azimuth_variance + b * other.azimuth_variance + a * b * d_azimuth**2
        self.rate_variance = a * self.rate_variance + b * other.rate_variance + a * b * d_rate**2
        self.elevation_variance = a * self.elevation_variance + b * other.elevation_variance + a * b * d_elevation**2
        self.ar = a * self.ar + b * other.ar + a * b * d_azimuth * d_rate
        self.ae = a * self.ae + b * other.ae + a * b * d_azimuth * d_elevation
        self.re = a * self.re + b * other.re + a * b * d_rate * d_elevation
        self.p_outlier = a * self.p_outlier + b * other.p_outlier
        self.elevation_measured = self.elevation_measured or other.elevation_measured
        self.weight = total


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
