"""The posterior of the target's direction over time: prediction, and updates by measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import remainder, tau

from av_fusion.filter.doa_likelihood import Comparison, ConeLikelihood, DirectionLikelihood, DoaLikelihood
from av_fusion.filter.gaussian_component import ASSOCIATED, GaussianComponent, MotionModel, gaussian, share_within
from av_fusion.filter.gaussian_mixture import BirthComponent, GaussianMixture
from av_fusion.filter.process_noise import LEAST_IN_VIEW, AdaptiveProcessNoise
from av_fusion.filter.settings import BayesSettings
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement

UNIFORM_DENSITY = 1.0 / tau
IN_VIEW_S = 0.5  # since the last detection, within which the target counts as in view
LEAST_CLUTTER = 1e-3  # probability of clutter in a direction of arrival, however confident it is
LEAST_LIKELIHOOD = 1e-3  # of an image under a component
LARGEST_ODDS = 99.0  # that a detection is the target
# Steady motion is evidence against manoeuvres while measurements confirm it, and for this long after the newest of them;
# then the process noise returns to that of the motion model with this time constant.
STEADY_S, STEADY_DECAY_S = 0.5, 1.0


class Posterior:
    """A Gaussian mixture with the time for which it is valid.

    Measurements may be older than this time: they then update the present through the state at their own time (`lag`).

    Attributes:
        mixture: the density.
        process_noise: scale of the target's acceleration.
        time: instant in s for which the mixture is valid, None before the first measurement.
        newest_doa, newest_image, newest_sighting: newest capture times (s) of a direction of arrival, of an image, and of an
            image with detections.

    Parameters:
        settings: see `BayesSettings`.
    """

    def __init__(self, settings: BayesSettings) -> None:
        model = MotionModel(settings.acceleration_density, settings.elevation_density, settings.usual_elevation,
                            settings.usual_elevation_sigma**2)
        self._settings = settings
        self.mixture = GaussianMixture(model, settings.rate_sigma**2, settings.lost_sigma**2)
        self.process_noise = AdaptiveProcessNoise()
        self.time: float | None = None
        self.newest_doa = self.newest_image = self.newest_sighting = -math.inf

    def advance(self, time: float) -> float:
        """Predict to `time`; returns how much earlier (s) it is than the present, 0 after a prediction."""
        if self.time is None:
            self.time = time
        dt = time - self.time
        if dt <= 0.0:
            return -dt
        self.mixture.predict(dt, self.noise_scale(time), math.exp(-self._settings.loss_rate * dt))
        self.time = time
        return 0.0

    def noise_scale(self, time: float) -> float:
        """Factor of the acceleration density for a prediction to `time` (s)."""
        scale, primary = self.process_noise.value, self.mixture.primary()
        if time - self.newest_sighting < IN_VIEW_S:
            scale = max(scale, LEAST_IN_VIEW)
        unsupported = 0.0 if primary is None else time - primary.measured - STEADY_S
        return scale if unsupported <= 0.0 else 1.0 + (scale - 1.0) * math.exp(-unsupported / STEADY_DECAY_S)

    def update_doa(self, time: float, measurement: DoaMeasurement, yaw: float, yaw_rate: float, outlier_rate: float) -> None:
        """Update by a direction of arrival.

        Parameters:
            time (s): its capture time.
            measurement: the direction in the body frame.
            yaw (rad), yaw_rate (rad/s): yaw of the rig and its rate at that time.
            outlier_rate: long-run probability that it does not stem from the target.
        """
        lag = self.advance(time)
        # Windows overlap: each adds evidence of its new part only, as if its noise were larger by the inverse fraction.
        fraction = effective_sample_fraction(time, self.newest_doa, measurement.window)
        since, self.newest_doa = max(time - self.newest_doa, 0.0), max(self.newest_doa, time)
        # The rig's rotation during the window blurs the direction.
        blur = self._settings.sound_floor_sigma**2 + (yaw_rate * measurement.window) ** 2 / 48.0
        azimuths = [remainder(yaw + h.azimuth, tau) for h in measurement.hypotheses]
        variances = [h.azimuth_variance + blur for h in measurement.hypotheses]
        prior = measurement.confidence / len(azimuths)
        clutter = max(1.0 - measurement.confidence, LEAST_CLUTTER)
        peak = prior / math.sqrt(tau * min(variances)) / UNIFORM_DENSITY  # density over that of clutter, at its mode
        width = min(measurement.confidence / peak, 1.0)  # share of the circle that the measurement selects
        likelihood = self._likelihood(measurement, azimuths, variances, yaw, blur, fraction, lag)
        self.mixture.predict_outlier(since, outlier_rate, width)
        compared = self._compare(likelihood, lag)
        direct = [clutter**fraction + c.fit * peak**fraction for c in compared]
        self.mixture.update_outlier(direct, clutter**fraction + peak**fraction * width / math.sqrt(fraction))
        for c in compared:
            share = (1.0 - c.component.p_outlier) * c.fit * peak / (clutter + c.fit * peak)
            c.component.update(c.row, c.variance, c.innovation, share)
            if share >= ASSOCIATED:
                c.component.newest_doa = max(c.component.newest_doa, time)
        self.process_noise.adapt(fraction)
        born = fraction * (1.0 - self.mixture.p_outlier)
        self.mixture.add_births(lag, self.process_noise.value, [
            BirthComponent(azimuth, variance, prior * born, newest_doa=time)
            for azimuth, variance in zip(azimuths, variances, strict=True)])
        self.mixture.background *= 1.0 - (1.0 - clutter) * born  # the births' weight
        self.mixture.reduce()

    def _likelihood(self, measurement: DoaMeasurement, azimuths: Sequence[float], variances: Sequence[float], yaw: float,
                    blur: float, fraction: float, lag: float) -> DoaLikelihood:
        cone = measurement.cone
        if cone is None:
            return DirectionLikelihood(azimuths, [variance / fraction for variance in variances])
        axis = yaw + cone.axis
        if min(cone.angle, math.pi - cone.angle) ** 2 > 4.0 * variances[0]:
            self.mixture.split(axis, lag)
        return ConeLikelihood(axis, cone.cosine, (cone.variance + blur * cone.slope_squared) / fraction)

    def _compare(self, likelihood: DoaLikelihood, lag: float) -> list[Comparison]:
        compared = [likelihood.compare(component, lag) for component in self.mixture.components]
        for component, _, variance, innovation, _ in compared:
            self.process_noise.note(component.weight * (1.0 - component.p_outlier), component.rate, innovation, variance)
        return compared

    def update_camera(self, time: float, measurement: CameraMeasurement, yaw: float) -> float:
        """Update by an image.

        Parameters:
            time (s): its capture time.
            measurement: the image's detections in the body frame.
            yaw (rad): yaw of the rig at that time.

        Returns the score of the detection that supports the track, 0 if none does.
        """
        lag = self.advance(time)
        detections = measurement.detections
        # A detection after images without any is new evidence, however many images there were.
        newest = self.newest_sighting if detections else self.newest_image
        fraction = effective_sample_fraction(time, newest, self._settings.sight_correlation)
        self.newest_image = max(self.newest_image, time)
        visibility = measurement.visibility
        if not math.isfinite(visibility):
            visibility = self._settings.assumed_visibility
        score, primary = 0.0, self.mixture.primary()
        for component in self.mixture.components:
            supporting = self._update_component(component, time, measurement, yaw, lag, visibility, fraction)
            score = supporting if component is primary else score
        view_share = 2.0 * measurement.half_view * UNIFORM_DENSITY
        self.mixture.background *= (1.0 - view_share * self._settings.detection_probability * visibility) ** fraction
        best = measurement.best
        if best is not None:
            self.newest_sighting = max(self.newest_sighting, time)
            self.process_noise.adapt(fraction)
            # A calibrated score is the probability that this is the target, independent of the predicted direction.
            self.mixture.add_births(lag, self.process_noise.value, [
                BirthComponent(remainder(yaw + d.azimuth, tau), d.azimuth_variance, odds_of(d) * fraction, d, odds_of(d),
                               newest_sighting=time)
                for d in detections])
            score = best.score if primary is None else score
        self.mixture.reduce()
        return score

    def _update_component(self, component: GaussianComponent, time: float, measurement: CameraMeasurement, yaw: float,
                          lag: float, visibility: float, fraction: float) -> float:
        """Weigh and update a component by an image; the score of the detection that supports it, 0 if none does."""
        expected = component.expected_variance(lag)
        in_view = share_within(measurement.half_view, component.innovation(yaw + measurement.view_azimuth, lag), expected)
        chance = self._settings.detection_probability
        likelihood = missed = component.missed_detection(time, visibility, in_view * chance, fraction)
        score = 0.0
        if measurement.detections:
            width = 2.0 * measurement.half_view
            innovations = [component.innovation(remainder(yaw + d.azimuth, tau), lag) for d in measurement.detections]
            found = [chance * odds_of(d) * width * gaussian(innovation, expected + d.azimuth_variance)
                     for innovation, d in zip(innovations, measurement.detections, strict=True)]
            likelihood += sum(found)
            shares = [f / likelihood for f in found]
            score = self._associate(component, lag, innovations, shares, measurement.detections)
            if sum(shares) >= ASSOCIATED:
                component.newest_sighting = max(component.newest_sighting, time)
            component.p_hidden *= missed / likelihood  # what was detected is not hidden
        component.weight *= max(likelihood, LEAST_LIKELIHOOD) ** fraction
        return score

    def _associate(self, component: GaussianComponent, lag: float, innovations: Sequence[float], shares: Sequence[float],
                   detections: Sequence[Detection]) -> float:
        """Update a component by detections with their association probabilities."""
        # The nearest detection counts for the process noise even if it is not associated: the target may be turning away.
        innovation, nearest = min(zip(innovations, detections, strict=True), key=lambda pair: abs(pair[0]))
        self.process_noise.note(component.weight, component.rate, innovation,
                                component.expected_variance(lag) + nearest.azimuth_variance)
        component.update_azimuth(lag, innovations, [d.azimuth_variance for d in detections], shares)
        score = 0.0
        for detection, share in zip(detections, shares, strict=True):
            component.update_elevation(detection.elevation, detection.elevation_variance, share)
            if share > 0.5:
                score = detection.score
        return score


def odds_of(detection: Detection) -> float:
    """Odds that a detection is the target."""
    return min(detection.score / max(1.0 - detection.score, 0.01), LARGEST_ODDS)


def effective_sample_fraction(time: float, newest: float, correlation: float) -> float:
    """Share of a measurement that is new evidence, when errors are correlated over `correlation` s.

    Parameters:
        time (s): capture time of the measurement.
        newest (s): capture time of the newest earlier measurement.
        correlation (s): correlation time of the errors.
    """
    return min(1.0, max(abs(time - newest) / correlation, 0.02)) if correlation > 0.0 else 1.0
