"""The density of one target's direction over time: prediction, and updates by measurements that may stem from others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from av_fusion.filter.consistency import SensorConsistency
from av_fusion.filter.doa_likelihood import Comparison
from av_fusion.filter.gaussian_component import ASSOCIATED, GaussianComponent
from av_fusion.filter.gaussian_mixture import GaussianMixture
from av_fusion.filter.hearing import Hearing
from av_fusion.filter.normal_distribution import gaussian, share_within
from av_fusion.filter.past_state import PastState
from av_fusion.filter.process_noise import AdaptiveProcessNoise
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.world_direction import Deviation, WorldDirection, distance
from av_fusion.measurement.measurements import CameraMeasurement, Detection
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import ZERO, Rows, Vector, angles, dot, tangents, turned

IN_VIEW_S = 0.5  # since the last detection, within which the target counts as in view
LEAST_LIKELIHOOD = 1e-3  # of an image under a component
LEAST_ELEVATION_ASSOCIATION = 0.05  # probability below which an elevation is not used
MAX_GAP_S = 5.0  # a longer gap between measurements, or jump of the clock, starts new tracks
LARGEST_ODDS = 99.0  # that a detection is the target
# Steady motion is evidence against manoeuvres while measurements confirm it, and for this long after the newest of them;
# then the process noise returns to that of the motion model with this time constant.
STEADY_S, STEADY_DECAY_S = 0.5, 1.0


class Image(NamedTuple):
    """An image as the filters use it.

    Parameters:
        time (s): its capture time.
        measurement: detections in the body frame.
        directions: those of the detections in the world.
        view: axes of the camera in the world.
        visibility: 0..1, known or assumed.
        fraction: effective sample fraction.
    """

    time: float
    measurement: CameraMeasurement
    directions: Sequence[WorldDirection]
    view: Sequence[Vector]
    visibility: float
    fraction: float

    @classmethod
    def of(cls, time: float, measurement: CameraMeasurement, attitude: Rows, visibility: float, fraction: float) -> Image:
        """The image turned into the world by the rig's attitude of its time; `visibility` where it has none."""
        return cls(time, measurement, [WorldDirection.of(detection, attitude) for detection in measurement.detections],
                   [turned(attitude, axis) for axis in zip(*measurement.view, strict=True)],
                   measurement.visibility if math.isfinite(measurement.visibility) else visibility, fraction)


class SightComparison(NamedTuple):
    """An image compared with what a component predicts.

    Parameters:
        component, past: the component, and its direction at the capture time.
        deviations: of each detection.
        missed: probability that the image does not show the target.
        found: likelihood ratio of each detection, from the target over a false one.
    """

    component: GaussianComponent
    past: PastState
    deviations: Sequence[Sequence[Deviation]]
    missed: float
    found: Sequence[float]


class TargetDensity:
    """A Gaussian mixture with the time for which it is valid.

    Measurements may be older than this time: they then update the present through the state at their own time (`lag`).

    Attributes:
        mixture: the density.
        process_noise: scale of the target's acceleration.
        consistency: of the innovations.
        time: instant in s for which the mixture is valid, None before the first measurement.
        newest_sighting: newest capture time (s) of an image with detections.
        manoeuvre_gate: square of an innovation, in standard deviations, from which it is no manoeuvre but another target.

    Parameters:
        settings: see `BayesSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, settings: BayesSettings, motion: RigMotion) -> None:
        self._settings, self._motion = settings, motion
        self.mixture = GaussianMixture(settings.model, settings.rate_sigma**2, settings.lost_sigma**2)
        self.process_noise = AdaptiveProcessNoise()
        self.consistency = SensorConsistency()
        self.time: float | None = None
        self.newest_sighting = -math.inf
        self.manoeuvre_gate = math.inf

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
        least = self.process_noise.least(in_view=time - self.newest_sighting < IN_VIEW_S)
        return self._while_supported(max(self.process_noise.value, least), time)

    def variance_scale(self, time: float, seen: bool) -> float:
        """Ratio of the variance of the track's errors at `time` (s) to that of the filter; `seen` where sight leads."""
        return self._while_supported(self.consistency.scale(seen), time)

    def _while_supported(self, scale: float, time: float) -> float:
        """A scale that returns to 1 where measurements do not support the track at `time` (s)."""
        primary = self.mixture.primary()
        unsupported = 0.0 if primary is None else time - primary.measured - STEADY_S
        return scale if unsupported <= 0.0 else 1.0 + (scale - 1.0) * math.exp(-unsupported / STEADY_DECAY_S)

    def adapt_to_sound(self, fraction: float) -> None:
        """Adapt to the innovations of a window of the effective sample fraction `fraction`."""
        self.process_noise.adapt(fraction)
        self.consistency.sound.adapt(fraction)

    def adapt_to_sight(self, fraction: float) -> None:
        """Adapt to the innovations of an image with detections, of the effective sample fraction `fraction`."""
        self.process_noise.adapt(fraction)
        self.consistency.adapt_to_sight(fraction)

    def compare_sound(self, heard: Sequence[Hearing], lag: float, moved: Vector) -> list[list[Comparison]]:
        """Each component compared with each direction of arrival of one window; components at end-fire are split first.

        Parameters:
            heard: the directions of arrival.
            lag (s), moved (m): see `advance`.
        """
        for axis in {hearing.end_fire for hearing in heard if hearing.end_fire is not None}:
            self.mixture.split(axis, lag, moved)
        compared = []
        for component in self.mixture.components:
            past = component.at(lag, moved)
            compared.append([hearing.likelihood.compare(component, past) for hearing in heard])
        return compared

    def note_innovation(self, comparison: Comparison, fraction: float, weight: float = 1.0) -> None:
        """Note the innovation of a direction of arrival under a component.

        Parameters:
            comparison: of the component with it.
            fraction: effective sample fraction, by which the direction's variance has been divided.
            weight: probability that it concerns this target.
        """
        component, deviation = comparison.component, comparison.deviations[0]
        if deviation.distance < self.manoeuvre_gate:
            weight *= component.weight * (1.0 - component.p_outlier)
            self.process_noise.note(weight, component.across_rate, deviation.innovation, deviation.total,
                                    slope=abs(deviation.row[0]))
            own = deviation.total - (1.0 - fraction) * deviation.noise    # with the variance of the direction itself
            self.consistency.sound.note(weight, deviation.innovation, own)

    @staticmethod
    def update_by_sound(time: float, comparisons: Sequence[Comparison], shares: Sequence[float]) -> None:
        """Update a component by directions of arrival with their association probabilities.

        Parameters:
            time (s): their capture time.
            comparisons: of the component with each of them.
            shares: probability of each that it stems from this component; they sum to at most one.
        """
        component, past = comparisons[0].component, comparisons[0].past
        across = [comparison.deviations[0] for comparison in comparisons]
        row = across[shares.index(max(shares))].row  # those of directions far away differ
        update = component.update_across if comparisons[0].direction is None else component.update_alternatives
        update(past, row, [d.innovation for d in across],
               [max(d.total - past.variance(d.row), d.noise) for d in across], shares)
        known = [(comparison.direction, share) for comparison, share in zip(comparisons, shares, strict=True)
                 if comparison.direction is not None and comparison.direction.is_known]
        _update_elevation(component, past, known)
        if sum(shares) >= ASSOCIATED:
            component.newest_doa = max(component.newest_doa, time)

    def compare_image(self, image: Image, lag: float, moved: Vector) -> list[SightComparison]:
        """Each component compared with an image. The probability that fog hides it is predicted to the image's time.

        Parameters:
            image: the image.
            lag (s), moved (m): see `advance`.
        """
        detections, width = image.measurement.detections, 2.0 * image.measurement.half_view
        detected, compared = self._settings.detection_probability, []
        for component in self.mixture.components:
            past = component.at(lag, moved)
            chance = detected * share_in_view(past, image.view, image.measurement)
            missed = component.missed_detection(image.time, image.visibility, chance, image.fraction)
            deviations = [direction.deviations(past) for direction in image.directions]
            found = [detected * odds_of(d) * width * _density(parts) for d, parts in zip(detections, deviations, strict=True)]
            compared.append(SightComparison(component, past, deviations, missed, found))
        return compared

    def update_by_image(self, image: Image, compared: SightComparison, free: Sequence[float]) -> float:
        """Weigh and update a component by an image; the score of the detection that supports it, 0 if none does.

        Parameters:
            image: the image.
            compared: the component, compared with it.
            free: factors of the detections' likelihood ratios: how far each is not explained by other targets.
        """
        component, past, deviations, likelihood, found = compared
        score = 0.0
        if image.directions:
            found = [ratio * factor for ratio, factor in zip(found, free, strict=True)]
            missed, likelihood = likelihood, likelihood + sum(found)
            shares = [ratio / likelihood for ratio in found]
            self._note_nearest(component, deviations, shares)
            _associate(component, past, image.directions, deviations, shares)
            score = max((d.score for d, share in zip(image.measurement.detections, shares, strict=True) if share > ASSOCIATED),
                        default=0.0)
            if sum(shares) >= ASSOCIATED:
                component.newest_sighting = max(component.newest_sighting, image.time)
            component.p_hidden *= missed / likelihood  # what was detected is not hidden
        component.weight *= max(likelihood, LEAST_LIKELIHOOD) ** image.fraction
        return score

    def _note_nearest(self, component: GaussianComponent, deviations: Sequence[Sequence[Deviation]], shares: Sequence[float]
                      ) -> None:
        """Note the nearest detection by its association probability: false ones are no manoeuvres."""
        nearest = min(range(len(deviations)), key=lambda k: distance(deviations[k]))
        across, *others = deviations[nearest]
        weight, level = component.weight * shares[nearest], math.cos(component.elevation) ** 2
        if across.distance < self.manoeuvre_gate:
            self.process_noise.note(weight, component.across_rate, across.innovation, across.total)
            self.consistency.sight.note(weight, across.innovation, across.total)
            for part in others:  # overhead both axes are alike
                self.process_noise.note((1.0 - level) * weight, component.up_rate, part.innovation, part.total)


def _associate(component: GaussianComponent, past: PastState, directions: Sequence[WorldDirection],
               deviations: Sequence[Sequence[Deviation]], shares: Sequence[float]) -> None:
    """Update a component by detections with their association probabilities."""
    nearest = min(deviations, key=distance)[0]
    component.update_alternatives(past, nearest.row, [parts[0].innovation for parts in deviations],
                                  [parts[0].noise for parts in deviations], shares)
    _update_elevation(component, past, [(direction, share) for direction, share in zip(directions, shares, strict=True)
                                        if direction.is_known])


def _update_elevation(component: GaussianComponent, past: PastState, known: Sequence[tuple[WorldDirection, float]]) -> None:
    """Update a component by the elevations of directions with their association probabilities."""
    if sum([share for _, share in known]) > LEAST_ELEVATION_ASSOCIATION:
        past = component.at(past.lag, past.moved)
        ups = [direction.deviations(past)[1] for direction, _ in known]
        shares = [share for _, share in known]
        row = ups[shares.index(max(shares))].row  # axes of directions far away differ
        component.update_alternatives(past, row, [up.innovation for up in ups], [up.noise for up in ups], shares)
        component.elevation_measured = True


def _density(deviations: Sequence[Deviation]) -> float:
    """Density of a detection under a component, across; reduced by its deviation up."""
    across, *others = deviations
    return gaussian(across.innovation, across.total) * math.exp(-0.5 * distance(others))


def share_in_view(past: PastState, view: Sequence[Vector], measurement: CameraMeasurement) -> float:
    """Probability that a component is in the field of view.

    Parameters:
        past: the component at the image's capture time.
        view: axes of the camera in the world.
        measurement: the image.
    """
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
