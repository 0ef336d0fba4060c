"""The posterior of the target's direction over time: prediction, and updates by measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from math import tau

from av_fusion.filter.doa_likelihood import Comparison, DirectionLikelihood, DoaLikelihood, WorldCone
from av_fusion.filter.gaussian_component import ASSOCIATED, GaussianComponent, gaussian, share_within
from av_fusion.filter.gaussian_mixture import BirthComponent, GaussianMixture
from av_fusion.filter.past_state import PastState
from av_fusion.filter.process_noise import LEAST_IN_VIEW, AdaptiveProcessNoise
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.world_direction import Deviation, WorldDirection, distance
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import ZERO, Rows, Vector, angles, combined, cross, dot, tangents, turned

UNIFORM_DENSITY = 1.0 / tau
IN_VIEW_S = 0.5  # since the last detection, within which the target counts as in view
STAMP_S = 0.01  # error of the stamp of a direction of arrival relative to that of the rig's attitude
LEAST_CLUTTER = 1e-3  # probability of clutter in a direction of arrival, however confident it is
LEAST_LIKELIHOOD = 1e-3  # of an image under a component
LEAST_ELEVATION_ASSOCIATION = 0.05  # probability below which an elevation is not used
LARGEST_ODDS = 99.0  # that a detection is the target
# Steady motion is evidence against manoeuvres while measurements confirm it, and for this long after the newest of them;
# then the process noise returns to that of the motion model with this time constant.
STEADY_S, STEADY_DECAY_S = 0.5, 1.0


class Posterior:
    """A Gaussian mixture with the time for which it is valid.

    Measurements may be older than this time: they then update the present through the state at their own time (`lag`). Each is
    turned into the world by the rig's attitude at its own time.

    Attributes:
        mixture: the density.
        process_noise: scale of the target's acceleration.
        time: instant in s for which the mixture is valid, None before the first measurement.
        newest_doa, newest_image, newest_sighting: newest capture times (s) of a direction of arrival, of an image, and of an
            image with detections.

    Parameters:
        settings: see `BayesSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, settings: BayesSettings, motion: RigMotion) -> None:
        self._model = settings.model
        self._settings, self._motion = settings, motion
        self.mixture = GaussianMixture(self._model, settings.rate_sigma**2, settings.lost_sigma**2)
        self.process_noise = AdaptiveProcessNoise()
        self.time: float | None = None
        self.newest_doa = self.newest_image = self.newest_sighting = -math.inf

    def advance(self, time: float) -> tuple[float, Vector]:
        """Predict to `time`.

        Returns how much earlier (s) it is than the present, 0 after a prediction, and the displacement of the rig since (m).
        """
        if self.time is None:
            self.time = time
        dt = time - self.time
        if dt <= 0.0:
            return -dt, self._motion.moved(time, self.time) if dt < 0.0 else ZERO
        self.mixture.predict(dt, self.noise_scale(time), math.exp(-self._settings.loss_rate * dt),
                             self._motion.moved(self.time, time))
        self.time = time
        return 0.0, ZERO

    def noise_scale(self, time: float) -> float:
        """Factor of the acceleration density for a prediction to `time` (s)."""
        scale, primary = self.process_noise.value, self.mixture.primary()
        if time - self.newest_sighting < IN_VIEW_S:
            scale = max(scale, LEAST_IN_VIEW)
        unsupported = 0.0 if primary is None else time - primary.measured - STEADY_S
        return scale if unsupported <= 0.0 else 1.0 + (scale - 1.0) * math.exp(-unsupported / STEADY_DECAY_S)

    def update_doa(self, time: float, measurement: DoaMeasurement, outlier_rate: float) -> None:
        """Update by a direction of arrival.

        Parameters:
            time (s): its capture time.
            measurement: the direction in the body frame.
            outlier_rate: long-run probability that it does not stem from the target.
        """
        lag, moved = self.advance(time)
        # Windows overlap: each adds evidence of its new part only, as if its noise were larger by the inverse fraction.
        fraction = effective_sample_fraction(time, self.newest_doa, measurement.window)
        since, self.newest_doa = max(time - self.newest_doa, 0.0), max(self.newest_doa, time)
        # A direction is that at the centre of its window, whatever moves within; stamps of sound and attitude differ a little.
        blur = combined(STAMP_S, self._motion.rate(time), 0.0, ZERO)
        floor = self._settings.sound_floor_sigma**2 + blur[2] ** 2
        variance = min(h.across_variance for h in measurement.hypotheses) + floor
        clutter = max(1.0 - measurement.confidence, LEAST_CLUTTER)
        # Density over that of clutter, at its mode.
        peak = measurement.confidence / len(measurement.hypotheses) / math.sqrt(tau * variance) / UNIFORM_DENSITY
        width = min(measurement.confidence / peak, 1.0)  # share of the circle that the measurement selects
        attitude, cone = self._motion.attitude(time), measurement.cone
        if cone is None:
            likelihood, births = self._hear_directions(measurement, attitude, floor, fraction)
        else:
            axis = turned(attitude, cone.axis)
            if min(cone.angle, math.pi - cone.angle) ** 2 > 4.0 * variance:
                self.mixture.split(axis, lag, moved)
            likelihood, births = self._hear_cone(cone, axis, blur, fraction)
        self.mixture.predict_outlier(since, outlier_rate, width)
        compared = [likelihood.compare(component, component.at(lag, moved)) for component in self.mixture.components]
        self._weigh_and_update(compared, time, clutter, peak, width, fraction)
        born = fraction * (1.0 - self.mixture.p_outlier)
        self.mixture.add_births(lag, self.process_noise.value, moved, [
            birth._replace(ratio=birth.ratio * measurement.confidence * born, newest_doa=time) for birth in births])
        self.mixture.background *= 1.0 - (1.0 - clutter) * born  # the births' weight
        self.mixture.reduce()

    def _hear_cone(self, cone: Cone, axis: Vector, blur: Vector, fraction: float) -> tuple[DoaLikelihood, list[BirthComponent]]:
        """A cone about an axis in the world; both images are where it meets the likely elevations of the sky."""
        variance = cone.variance + self._settings.sound_floor_sigma**2 * cone.slope_squared
        heard = WorldCone(axis, cone.cosine, variance, cross(blur, axis))
        images = heard.sky_images(self._model.usual_elevation, self._model.usual_elevation_variance)
        births = [BirthComponent(image.azimuth, image.elevation, image.hh, image.hv, image.vv,
                                 partial(heard.explained_by, side=image.side), 1.0 / len(images)) for image in images]
        return heard._replace(variance=variance / fraction, blur=combined(fraction**-0.5, heard.blur, 0.0, ZERO)), births

    def _hear_directions(self, measurement: DoaMeasurement, attitude: Rows, floor: float, fraction: float
                         ) -> tuple[DoaLikelihood, list[BirthComponent]]:
        """Alternative directions; of mirror images the one closer to the usual elevation is the more likely."""
        heard = [WorldDirection.of(hypothesis, attitude, floor) for hypothesis in measurement.hypotheses]
        births = [self._birth_of(direction, 1.0) for direction in heard]
        usual, spread = self._model.usual_elevation, self._model.usual_elevation_variance
        weights = [math.exp(max(-0.5 * (b.elevation - usual) ** 2 / (spread + b.vv), -300.0)) for b in births]
        births = [birth._replace(ratio=weight / sum(weights)) for birth, weight in zip(births, weights, strict=True)]
        return DirectionLikelihood([d._replace(across_variance=d.across_variance / fraction,
                                               up_variance=d.up_variance / fraction) for d in heard]), births

    def _weigh_and_update(self, compared: Sequence[Comparison], time: float, clutter: float, peak: float, width: float,
                          fraction: float) -> None:
        """Weigh the components by a direction of arrival, and update each as far as it explains it."""
        for component, _, (deviation, *_others), _fit, _direction in compared:
            self.process_noise.note(component.weight * (1.0 - component.p_outlier), component.across_rate,
                                    deviation.innovation, deviation.total)
        direct = [clutter**fraction + c.fit * peak**fraction for c in compared]
        self.mixture.update_outlier(direct, clutter**fraction + peak**fraction * width / math.sqrt(fraction))
        for component, past, (deviation, *others), fit, direction in compared:
            share = (1.0 - component.p_outlier) * fit * peak / (clutter + fit * peak)
            update = component.update if direction is not None else component.update_across
            update(past, deviation.row, deviation.total, deviation.innovation, share)
            if others and direction is not None and share > LEAST_ELEVATION_ASSOCIATION:
                past = component.at(past.lag, past.moved)
                up = direction.deviations(past)[1]
                component.update(past, up.row, up.total, up.innovation, share)
                component.elevation_measured = True
            if share >= ASSOCIATED:
                component.newest_doa = max(component.newest_doa, time)
        self.process_noise.adapt(fraction)

    def _birth_of(self, direction: WorldDirection, ratio: float) -> BirthComponent:
        azimuth, elevation = angles(direction.vector)
        across, variance = direction.across_variance, direction.up_variance
        if not direction.is_known:
            elevation, variance = self._model.usual_elevation, self._model.usual_elevation_variance
        left, above = tangents(azimuth, elevation)
        c, s = dot(direction.left, left), dot(direction.left, above)
        return BirthComponent(azimuth, elevation, c * c * across + s * s * variance, c * s * (across - variance),
                              s * s * across + c * c * variance,
                              lambda past: all(part.distance < 9.0 for part in direction.deviations(past)), ratio,
                              direction.is_known)

    def update_camera(self, time: float, measurement: CameraMeasurement) -> float:
        """Update by an image.

        Parameters:
            time (s): its capture time.
            measurement: the image's detections in the body frame.

        Returns the score of the detection that supports the track, 0 if none does.
        """
        lag, moved = self.advance(time)
        attitude = self._motion.attitude(time)
        directions = [WorldDirection.of(detection, attitude) for detection in measurement.detections]
        # A detection after images without any is new evidence, however many images there were.
        newest = self.newest_sighting if directions else self.newest_image
        fraction = effective_sample_fraction(time, newest, self._settings.sight_correlation)
        self.newest_image = max(self.newest_image, time)
        visibility = measurement.visibility
        if not math.isfinite(visibility):
            visibility = self._settings.assumed_visibility
        view = tuple(turned(attitude, axis) for axis in zip(*measurement.view, strict=True))
        score, primary = 0.0, self.mixture.primary()
        for component in self.mixture.components:
            past = component.at(lag, moved)
            chance = self._settings.detection_probability * _share_in_view(past, view, measurement)
            supporting = self._update_by_sight(component, past, time, measurement, directions, chance, visibility, fraction)
            score = supporting if component is primary else score
        view_share = 2.0 * measurement.half_view * UNIFORM_DENSITY
        self.mixture.background *= (1.0 - view_share * self._settings.detection_probability * visibility) ** fraction
        best = measurement.best
        if best is not None:
            self.newest_sighting = max(self.newest_sighting, time)
            self.process_noise.adapt(fraction)
            # A calibrated score is the probability that this is the target, independent of the predicted direction.
            self.mixture.add_births(lag, self.process_noise.value, moved, [
                self._birth_of(direction, odds_of(d) * fraction)._replace(least=odds_of(d), newest_sighting=time)
                for d, direction in zip(measurement.detections, directions, strict=True)])
            score = best.score if primary is None else score
        self.mixture.reduce()
        return score

    def _update_by_sight(self, component: GaussianComponent, past: PastState, time: float, measurement: CameraMeasurement,
                         directions: Sequence[WorldDirection], chance: float, visibility: float, fraction: float) -> float:
        """Weigh and update a component by an image; the score of the detection that supports it, 0 if none does."""
        likelihood = missed = component.missed_detection(time, visibility, chance, fraction)
        score = 0.0
        if directions:
            width = 2.0 * measurement.half_view
            deviations = [direction.deviations(past) for direction in directions]
            found = [self._settings.detection_probability * odds_of(d) * width * _density(parts)
                     for d, parts in zip(measurement.detections, deviations, strict=True)]
            likelihood += sum(found)
            shares = [f / likelihood for f in found]
            self._associate(component, past, directions, deviations, shares)
            score = max((d.score for d, share in zip(measurement.detections, shares, strict=True) if share > ASSOCIATED),
                        default=0.0)
            if sum(shares) >= ASSOCIATED:
                component.newest_sighting = max(component.newest_sighting, time)
            component.p_hidden *= missed / likelihood  # what was detected is not hidden
        component.weight *= max(likelihood, LEAST_LIKELIHOOD) ** fraction
        return score

    def _associate(self, component: GaussianComponent, past: PastState, directions: Sequence[WorldDirection],
                   deviations: Sequence[Sequence[Deviation]], shares: Sequence[float]) -> None:
        """Update a component by detections with their association probabilities."""
        # The nearest detection counts for the process noise even if it is not associated: the target may be turning away.
        nearest, *others = min(deviations, key=distance)
        self.process_noise.note(component.weight, component.across_rate, nearest.innovation, nearest.total)
        level = math.cos(component.elevation) ** 2
        for part in others:  # overhead both axes are alike
            self.process_noise.note((1.0 - level) * component.weight, component.up_rate, part.innovation, part.total)
        component.update_alternatives(past, nearest.row, [parts[0].innovation for parts in deviations],
                                      [parts[0].noise for parts in deviations], shares)
        known = [(direction, share) for direction, share in zip(directions, shares, strict=True) if direction.is_known]
        if sum([share for _, share in known]) > LEAST_ELEVATION_ASSOCIATION:
            past = component.at(past.lag, past.moved)
            ups = [direction.deviations(past)[1] for direction, _ in known]
            component.update_alternatives(past, ups[0].row, [up.innovation for up in ups], [up.noise for up in ups],
                                          [share for _, share in known])
            component.elevation_measured = True


def _density(deviations: Sequence[Deviation]) -> float:
    """Density of a detection under a component, across; reduced by its deviation up."""
    across, *others = deviations
    return gaussian(across.innovation, across.total) * math.exp(-0.5 * distance(others))


def _share_in_view(past: PastState, view: Sequence[Vector], measurement: CameraMeasurement) -> float:
    """Probability that a component is in the field of view; `view` holds the camera's axes in the world."""
    x, y, z = (dot(axis, past.direction) for axis in view)
    azimuth, elevation = angles((x, y, z))
    across, up = tangents(azimuth, elevation)
    rows = [(sum(a * dot(axis, past.left) for a, axis in zip(part, view, strict=True)),
             sum(a * dot(axis, past.above) for a, axis in zip(part, view, strict=True))) for part in (across, up)]
    level = max(math.cos(elevation) ** 2, 1e-6)
    return (share_within(measurement.half_view, azimuth, past.variance(rows[0]) / level)
            * share_within(measurement.half_height, elevation, past.variance(rows[1])))


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
