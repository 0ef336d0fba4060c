"""The posterior of the direction of the only target: measurements stem from it, from outliers, or from clutter."""

from __future__ import annotations

import math
from collections.abc import Sequence

from av_fusion.filter.doa_likelihood import Comparison
from av_fusion.filter.hearing import UNIFORM_DENSITY, Hearing, birth_of
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.target_density import Image, SightComparison, TargetDensity, odds_of
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

    def use_only_sound(self, time: float, compared: Sequence[Comparison], heard: Hearing, free: float, outlier_rate: float,
                       since: float, fraction: float, lag: float, moved: Vector) -> None:
        """Weigh and update the components by a direction of arrival, and start others as it may stem from elsewhere.

        Windows overlap: each adds evidence of its new part only, as if its noise were larger by the inverse fraction.

        Parameters:
            time (s): its capture time.
            compared: of the components with it.
            heard: the direction.
            free: how far no other target explains it.
            outlier_rate: long-run probability that it does not stem from the target.
            since (s): time since the previous one.
            fraction: effective sample fraction.
            lag (s), moved (m): see `advance`.
        """
        self.newest_doa = max(self.newest_doa, time)
        self._weigh_and_update(time, compared, heard._replace(peak=heard.peak * free), since, outlier_rate, fraction)
        born = free * fraction * (1.0 - self.mixture.p_outlier)
        self.mixture.add_births(lag, self.process_noise.value, moved, [
            birth._replace(ratio=birth.ratio * heard.confidence * born, newest_doa=time) for birth in heard.births])
        self.mixture.background *= 1.0 - (1.0 - heard.clutter) * born  # the births' weight
        self.mixture.reduce()

    def _weigh_and_update(self, time: float, compared: Sequence[Comparison], heard: Hearing, since: float,
                          outlier_rate: float, fraction: float) -> None:
        """Weigh the components by a direction of arrival, and update each as far as it explains it."""
        clutter, peak = heard.clutter, heard.peak
        self.mixture.predict_outlier(since, outlier_rate, heard.width)
        for comparison in compared:
            self.note_innovation(comparison, fraction)
        direct = [clutter**fraction + comparison.fit * peak**fraction for comparison in compared]
        self.mixture.update_outlier(direct, clutter**fraction + peak**fraction * heard.width / math.sqrt(fraction))
        for comparison in compared:
            explained = comparison.fit * peak
            share = (1.0 - comparison.component.p_outlier) * explained / (clutter + explained)
            self.update_by_sound(time, [comparison], [share])
        self.adapt_to_sound(fraction)

    def use_only_image(self, image: Image, compared: Sequence[SightComparison], free: Sequence[float], lag: float,
                       moved: Vector) -> float:
        """Weigh and update the components by an image, and start others where it shows the target elsewhere.

        Parameters:
            image: the image.
            compared: of the components with it.
            free: how far no other target explains each detection.
            lag (s), moved (m): see `advance`.

        Returns the score of the detection that supports the track, 0 if none does.
        """
        measurement, fraction = image.measurement, image.fraction
        self.newest_image = max(self.newest_image, image.time)
        score, primary = 0.0, self.mixture.primary()
        for comparison in compared:
            supporting = self.update_by_image(image, comparison, free)
            score = supporting if comparison.component is primary else score
        view_share = 2.0 * measurement.half_view * UNIFORM_DENSITY
        self.mixture.background *= (1.0 - view_share * self._settings.detection_probability * image.visibility) ** fraction
        best = measurement.best
        if best is not None:
            self.newest_sighting = max(self.newest_sighting, image.time)
            self.adapt_to_sight(fraction)
            # A calibrated score is the probability that this is the target, independent of the predicted direction.
            odds = [odds_of(detection) * share for detection, share in zip(measurement.detections, free, strict=True)]
            self.mixture.add_births(lag, self.process_noise.value, moved, [
                birth_of(direction, ratio * fraction, self._settings)._replace(least=ratio, newest_sighting=image.time)
                for ratio, direction in zip(odds, image.directions, strict=True)])
            score = best.score if primary is None else score
        self.mixture.reduce()
        return score
