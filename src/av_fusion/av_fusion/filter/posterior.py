"""The posterior of the direction of the only target: measurements stem from it, from outliers, or from clutter."""

from __future__ import annotations

import math

from av_fusion.filter.hearing import UNIFORM_DENSITY, Hearing, birth_of, hear
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.target_density import Image, TargetDensity, effective_sample_fraction, odds_of
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Vector


class Posterior(TargetDensity):
    """A `TargetDensity` with births from all measurements.

    Each measurement is turned into the world by the rig's attitude at its own time.

    Attributes:
        newest_doa, newest_image: newest capture times (s) of a direction of arrival and of an image.

    Parameters:
        settings: see `BayesSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, settings: BayesSettings, motion: RigMotion) -> None:
        super().__init__(settings, motion)
        self.newest_doa = self.newest_image = -math.inf

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
        heard = hear(time, measurement, fraction, self._settings, self._motion)
        self._weigh_and_update(time, heard, lag, moved, since, outlier_rate, fraction)
        born = fraction * (1.0 - self.mixture.p_outlier)
        self.mixture.add_births(lag, self.process_noise.value, moved, [
            birth._replace(ratio=birth.ratio * heard.confidence * born, newest_doa=time) for birth in heard.births])
        self.mixture.background *= 1.0 - (1.0 - heard.clutter) * born  # the births' weight
        self.mixture.reduce()

    def _weigh_and_update(self, time: float, heard: Hearing, lag: float, moved: Vector, since: float, outlier_rate: float,
                          fraction: float) -> None:
        """Weigh the components by a direction of arrival, and update each as far as it explains it."""
        compared, clutter, peak = self.compare_sound([heard], lag, moved), heard.clutter, heard.peak
        self.mixture.predict_outlier(since, outlier_rate, heard.width)
        for (comparison,) in compared:
            self.note_innovation(comparison, fraction)
        direct = [clutter**fraction + fit * peak**fraction for ((*_, fit, _),) in compared]
        self.mixture.update_outlier(direct, clutter**fraction + peak**fraction * heard.width / math.sqrt(fraction))
        for comparisons in compared:
            (component, _, _, fit, _), = comparisons
            self.update_by_sound(time, comparisons, [(1.0 - component.p_outlier) * fit * peak / (clutter + fit * peak)])
        self.adapt_to_sound(fraction)

    def update_camera(self, time: float, measurement: CameraMeasurement) -> float:
        """Update by an image.

        Parameters:
            time (s): its capture time.
            measurement: the image's detections in the body frame.

        Returns the score of the detection that supports the track, 0 if none does.
        """
        lag, moved = self.advance(time)
        # A detection after images without any is new evidence, however many images there were.
        newest = self.newest_sighting if measurement.detections else self.newest_image
        fraction = effective_sample_fraction(time, newest, self._settings.sight_correlation)
        self.newest_image = max(self.newest_image, time)
        image = Image.of(time, measurement, self._motion.attitude(time), self._settings.assumed_visibility, fraction)
        score, primary = 0.0, self.mixture.primary()
        free = [1.0] * len(image.directions)
        for compared in self.compare_image(image, lag, moved):
            supporting = self.update_by_image(image, compared, free)
            score = supporting if compared.component is primary else score
        view_share = 2.0 * measurement.half_view * UNIFORM_DENSITY
        self.mixture.background *= (1.0 - view_share * self._settings.detection_probability * image.visibility) ** fraction
        best = measurement.best
        if best is not None:
            self.newest_sighting = max(self.newest_sighting, time)
            self.adapt_to_sight(fraction)
            # A calibrated score is the probability that this is the target, independent of the predicted direction.
            self.mixture.add_births(lag, self.process_noise.value, moved, [
                birth_of(direction, odds_of(d) * fraction, self._settings)._replace(least=odds_of(d), newest_sighting=time)
                for d, direction in zip(measurement.detections, image.directions, strict=True)])
            score = best.score if primary is None else score
        self.mixture.reduce()
        return score
