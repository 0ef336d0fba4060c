"""A multi-Bernoulli filter: joint probabilistic data association with existence, births from unexplained measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from av_common.track import Source
from av_fusion.filter.component_merging import are_mergeable
from av_fusion.filter.gaussian_component import ASSOCIATED
from av_fusion.filter.gaussian_mixture import BirthComponent
from av_fusion.filter.hearing import UNIFORM_DENSITY, Hearing, birth_of, hear
from av_fusion.filter.target_density import Image, effective_sample_fraction, odds_of
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows, Vector
from av_fusion.multi_target.association import free_factors, unclaimed
from av_fusion.multi_target.bernoulli_track import BernoulliTrack
from av_fusion.multi_target.blade_pass import fundamental_likelihoods
from av_fusion.multi_target.settings import MultiTargetSettings

USUAL_WINDOW_S = 0.5  # of sound, for a window without any direction of arrival


class MultiTargetFilter:
    """Tracks with existence probabilities, and a uniform Poisson process of targets that were not detected yet.

    The track-oriented marginal filter of Williams, Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA, and
    association-based MeMBer, IEEE Transactions on Aerospace and Electronic Systems 51(3), 2015.

    Attributes:
        tracks: in the order of their ids.
        newest, newest_doa (s): newest capture times of any measurement, and of a direction of arrival.

    Parameters:
        settings: see `MultiTargetSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, settings: MultiTargetSettings, motion: RigMotion) -> None:
        self.tracks: list[BernoulliTrack] = []
        self._settings, self._motion = settings, motion
        self._newest_id = 0
        self.reset()

    def reset(self) -> None:
        """Discard all tracks; their ids are not used again."""
        self.tracks = []
        self.newest = self.newest_doa = self._newest_image = self._newest_sighting = -math.inf
        self._undetected = self._settings.undetected_first

    def turn_world(self, rows: Rows) -> None:
        """Turn all tracks with the world, where the rig's attitude was corrected."""
        for track in self.tracks:
            track.mixture.turn_world(rows)

    def update_sound(self, time: float, measurements: Sequence[DoaMeasurement]) -> None:
        """Update by the directions of arrival of one window.

        Parameters:
            time (s): its capture time.
            measurements: directions in the body frame, of different sources; none where nothing was heard.
        """
        window = max((measurement.window for measurement in measurements), default=USUAL_WINDOW_S)
        fraction = effective_sample_fraction(time, self.newest_doa, window)
        since = max(time - self.newest_doa, 0.0)
        self.newest_doa, self.newest = max(self.newest_doa, time), max(self.newest, time)
        places = [track.advance(time) for track in self.tracks]
        for track in self.tracks:
            track.predict_heard(since)
        heard = [hear(time, measurement, fraction, self._settings.target, self._motion) for measurement in measurements]
        if not heard:
            for track in self.tracks:
                track.miss_sound(fraction)
        else:
            self._use_sound(time, measurements, heard, places, fraction)
        self._detect(self._settings.sound_detection_probability, fraction)
        self._reduce(time)

    def _use_sound(self, time: float, measurements: Sequence[DoaMeasurement], heard: Sequence[Hearing],
                   places: Sequence[tuple[float, Vector]], fraction: float) -> None:
        compared = [track.compare_sound(heard, *place) for track, place in zip(self.tracks, places, strict=True)]
        ratios = np.array([track.sound_ratios(each, heard) for track, each in zip(self.tracks, compared, strict=True)]
                          ).reshape(len(self.tracks), len(heard))
        likelihoods = fundamental_likelihoods(measurements)
        voices = np.array([track.blade_pass.fits(likelihoods) * track.kind.fits([_kind(each) for each in measurements])
                           for track in self.tracks]).reshape(ratios.shape)
        voices /= np.maximum(voices.max(axis=0, initial=1.0), 1.0)  # an echo sounds alike: only other targets are told apart
        ratios *= voices
        odds = self._undetected * np.array([hearing.confidence / hearing.clutter for hearing in heard])
        free = free_factors(ratios, 1.0 + odds)
        unexplained = unclaimed(ratios, free, 1.0 + odds)
        for track, each, factors in zip(self.tracks, compared, free * voices, strict=True):
            if each and factors.any():  # where only others of another kind are heard, its silence tells nothing: they mask it
                track.use_sound(time, each, heard, factors, fraction)
        shares = self._note(time, ratios * free, Source.SOUND, [_kind(measurement) for measurement in measurements])
        for track, row in zip(self.tracks, shares, strict=True):
            track.blade_pass.update(likelihoods, row, fraction)
        for j, new in enumerate(unexplained * odds / (1.0 + odds)):
            begun = self._begin(time, [birth._replace(newest_doa=time) for birth in heard[j].births], fraction * float(new),
                                Source.SOUND, _kind(measurements[j]))
            if begun is not None:
                begun.blade_pass.update(likelihoods[j:j + 1], np.ones(1), fraction)

    def update_image(self, time: float, measurement: CameraMeasurement) -> None:
        """Update by an image.

        Parameters:
            time (s): its capture time.
            measurement: the image's detections in the body frame.
        """
        target, detections = self._settings.target, measurement.detections
        newest = self._newest_sighting if detections else self._newest_image
        fraction = effective_sample_fraction(time, newest, target.sight_correlation)
        self._newest_image, self.newest = max(self._newest_image, time), max(self.newest, time)
        places = [track.advance(time) for track in self.tracks]
        image = Image.of(time, measurement, self._motion.attitude(time), target.assumed_visibility, fraction)
        compared = [track.compare_image(image, *place) for track, place in zip(self.tracks, places, strict=True)]
        ratios = np.array([track.image_ratios(each, len(detections)) for track, each in zip(self.tracks, compared, strict=True)]
                          ).reshape(len(self.tracks), len(detections))
        odds = self._undetected * np.array([odds_of(detection) for detection in detections])
        free = free_factors(ratios, 1.0 + odds)
        for track, each, factors in zip(self.tracks, compared, free, strict=True):
            track.use_image(image, each, factors)
        if detections:
            self._newest_sighting = max(self._newest_sighting, time)
            self._note(time, ratios * free, Source.SIGHT, [detection.score for detection in detections])
            new = unclaimed(ratios, free, 1.0 + odds) * odds / (1.0 + odds)
            for detection, direction, existence in zip(detections, image.directions, new, strict=True):
                self._begin(time, [birth_of(direction, 1.0, target)._replace(newest_sighting=time)], float(existence),
                            Source.SIGHT, detection.score)
        self._detect(2.0 * measurement.half_view * UNIFORM_DENSITY * target.detection_probability * image.visibility, fraction)
        self._reduce(time)

    def _begin(self, time: float, births: Sequence[BirthComponent], existence: float, sensor: Source,
               probability: float) -> BernoulliTrack | None:
        """Start a track where a measurement of a sensor is not explained; `probability` that it is a drone."""
        track = None
        if births and existence >= self._settings.least_existence:
            self._newest_id += 1
            track = BernoulliTrack(self._newest_id, time, self._settings, self._motion)
            track.begin(births, existence)
            track.kind.note(sensor, [probability], [1.0])
            self.tracks.append(track)
        return track

    def _detect(self, probability: float, fraction: float) -> None:
        """Fewer targets are left that were not detected, although they could have been."""
        usual = self._settings.undetected
        self._undetected = usual + (self._undetected - usual) * (1.0 - probability) ** fraction

    def _note(self, time: float, claimed: NDArray[np.float64], sensor: Source, probabilities: Sequence[float]
              ) -> NDArray[np.float64]:
        """Note what the measurements of one scan tell of the kind of each track, and which tracks have different ones.

        Returns the probability (t, m) of each measurement that it stems from each track.
        """
        shares = claimed / (1.0 + claimed.sum(axis=1, keepdims=True))
        for track, row in zip(self.tracks, shares, strict=True):
            track.kind.note(sensor, probabilities, row.tolist())
        measured = [(track, int(row.argmax())) for track, row in zip(self.tracks, shares, strict=True)
                    if row.size and row.max() >= ASSOCIATED]
        for (one, first), (other, second) in combinations(measured, 2):
            if first != second:
                one.told_apart[other.id] = other.told_apart[one.id] = time
        return shares

    def _reduce(self, time: float) -> None:
        """End tracks that hardly exist, and merge those that have been one and the same for some time."""
        kept: list[BernoulliTrack] = []
        alive = [track for track in self.tracks if track.existence >= self._settings.least_existence]
        for track in sorted(alive, key=lambda each: -each.existence)[:self._settings.most_tracks]:
            other = next((other for other in kept if self._are_one(other, track, time)), None)
            if other is None:
                kept.append(track)
            else:
                self._merge(other, track)
        self.tracks = sorted(kept, key=lambda track: track.id)
        confirmed = [track for track in self.tracks if track.existence >= self._settings.confirmed]
        for one, another in combinations(confirmed, 2):
            one.compare_identity(another)
        for track in self.tracks:
            track.assume_alone(len(confirmed) < 2)

    def _are_one(self, first: BernoulliTrack, second: BernoulliTrack, time: float) -> bool:
        a, b, apart = first.mixture.primary(), second.mixture.primary(), first.told_apart.get(second.id)
        return (a is not None and b is not None and are_mergeable(a, b)
                and (apart is None or time - apart > self._settings.duplicate_time))

    def _merge(self, first: BernoulliTrack, second: BernoulliTrack) -> None:
        """Keep the more certain density of two tracks of one target, under the older id."""
        first.mixture.background *= second.mixture.background
        first.mixture.reduce()
        ended = max(first.id, second.id)
        if second.id < first.id:
            first.id, first.began, first.told_apart = second.id, second.began, second.told_apart
            first.confusions = second.confusions
        for track in self.tracks:
            track.confusions.pop(ended, None)


def _kind(measurement: DoaMeasurement) -> float:
    """Probability that what is heard is a target; NaN while it is not judged."""
    return math.nan if math.isnan(measurement.drone_probability) else measurement.target_probability
