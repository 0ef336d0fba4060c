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
from av_fusion.filter.outlier_rate import OutlierRateEstimator
from av_fusion.filter.target_density import Image, effective_sample_fraction, odds_of
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows, Vector
from av_fusion.multi_target.association import association_probabilities, free_factors, unclaimed
from av_fusion.multi_target.bernoulli_track import BernoulliTrack
from av_fusion.multi_target.blade_pass import fundamental_likelihoods
from av_fusion.multi_target.drone_evidence import DRONE
from av_fusion.multi_target.kind_by_place import kinds_by_place
from av_fusion.multi_target.settings import MultiTargetSettings
from av_fusion.multi_target.window import Window, associate, kind_of

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
        self.outlier_rate = OutlierRateEstimator(settings.target.outlier_rate).rate
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
        length = max((measurement.window for measurement in measurements), default=USUAL_WINDOW_S)
        fundamentals = fundamental_likelihoods(measurements)
        kinds = self._kinds(time, measurements, fundamentals, length)
        target = [j for j, kind in enumerate(kinds) if not kind < DRONE]
        only = self._only(time, begin=True) if len(target) == 1 else None
        newest = self.newest_doa if only is None else only.newest_doa
        fraction = effective_sample_fraction(time, newest, length)
        window = Window(time, self._heard(time, measurements, fraction), kinds, fundamentals, target, fraction,
                        max(time - newest, 0.0))
        elapsed = max(time - self.newest_doa, 0.0)
        self.newest_doa, self.newest = max(self.newest_doa, time), max(self.newest, time)
        # Where only others of another kind are heard, the silence of a track tells nothing: they mask it.
        tracks = [track for track in self.tracks if not window.heard or track.kind.fits(window.kinds).any()]
        for track in self.tracks:
            if track not in tracks:
                track.mixture.reduce()  # it was compared with all sounds, by which components at end-fire are split
        places = [track.advance(time) for track in tracks]
        for track in tracks:
            track.blade_pass.predict(elapsed)
            if track is not only:
                track.predict_heard(elapsed)
        if window.heard:
            self._use_sound(window, tracks, places, only)
        else:
            for track in tracks:
                track.miss_sound(fraction)
        self._detect(self._settings.sound_detection_probability, fraction)
        self._reduce(time)

    def _heard(self, time: float, measurements: Sequence[DoaMeasurement], fraction: float) -> list[Hearing]:
        return [hear(time, measurement, fraction, self._settings.target, self._motion) for measurement in measurements]

    def _kinds(self, time: float, measurements: Sequence[DoaMeasurement], fundamentals: NDArray[np.float64], length: float
               ) -> list[float]:
        """See `kinds_by_place`; `length` (s) is that of the window."""
        kinds = [kind_of(measurement) for measurement in measurements]
        heard = self._heard(time, measurements, effective_sample_fraction(time, self.newest_doa, length))
        compared = [track.compare_sound(heard, *track.advance(time)) for track in self.tracks]
        return kinds_by_place(self.tracks, compared, heard, kinds, fundamentals, self._undetected)

    def _use_sound(self, window: Window, tracks: Sequence[BernoulliTrack], places: Sequence[tuple[float, Vector]],
                   only: BernoulliTrack | None) -> None:
        """Update tracks by a window; `only` is the target of its only sound of a drone, see `_only`."""
        time, heard, fraction = window.time, window.heard, window.fraction
        compared = [track.compare_sound(heard, *place) for track, place in zip(tracks, places, strict=True)]
        odds = self._undetected * np.array([hearing.confidence / hearing.clutter for hearing in heard])
        if only is not None:
            odds[window.target] = 0.0
        free, shares, new = associate(window, tracks, compared, odds)
        for track, each, factors, place in zip(tracks, compared, free, places, strict=True):
            if track is only:
                j, = window.target
                track.use_only_sound(time, [comparisons[j] for comparisons in each], heard[j], float(factors[j]),
                                     self.outlier_rate(heard[j].confidence), window.since, fraction, *place)
            elif each:
                track.use_sound(time, each, heard, factors, fraction)
        self._note(tracks, shares, Source.SOUND, window.kinds, only, *window.target)
        for track, row in zip(tracks, shares, strict=True):
            track.blade_pass.update(window.fundamentals, row, fraction)
        for j, existence in enumerate(fraction * new):
            begun = self._begin(time, [birth._replace(newest_doa=time) for birth in heard[j].births], float(existence),
                                Source.SOUND, window.kinds[j])
            if begun is not None:
                begun.blade_pass.update(window.fundamentals[j:j + 1], np.ones(1), fraction)

    def update_image(self, time: float, measurement: CameraMeasurement) -> None:
        """Update by an image.

        Parameters:
            time (s): its capture time.
            measurement: the image's detections in the body frame.
        """
        target, detections = self._settings.target, measurement.detections
        only = self._only(time, bool(detections)) if len(detections) < 2 else None
        newest = self._newest_sighting if detections else self._newest_image
        fraction = effective_sample_fraction(time, newest, target.sight_correlation)
        self._newest_image, self.newest = max(self._newest_image, time), max(self.newest, time)
        places = [track.advance(time) for track in self.tracks]
        image = Image.of(time, measurement, self._motion.attitude(time), target.assumed_visibility, fraction)
        compared = [track.compare_image(image, *place) for track, place in zip(self.tracks, places, strict=True)]
        ratios = np.array([track.image_ratios(each, len(detections)) for track, each in zip(self.tracks, compared, strict=True)]
                          ).reshape(len(self.tracks), len(detections))
        odds = (self._undetected if only is None else 0.0) * np.array([odds_of(detection) for detection in detections])
        free = free_factors(ratios, 1.0 + odds)
        for track, each, factors, place in zip(self.tracks, compared, free, places, strict=True):
            if track is only:
                track.score = track.use_only_image(image, each, factors.tolist(), *place)
            else:
                track.use_image(image, each, factors)
        if detections:
            self._newest_sighting = max(self._newest_sighting, time)
            shares, scores = association_probabilities(ratios, free), [detection.score for detection in detections]
            clear = measurement.visibility if math.isfinite(measurement.visibility) else 1.0
            self._note(self.tracks, shares, Source.SIGHT, scores, only, visibility=clear)
            new = unclaimed(ratios, free, 1.0 + odds) * odds / (1.0 + odds)
            for detection, direction, existence in zip(detections, image.directions, new, strict=True):
                self._begin(time, [birth_of(direction, 1.0, target)._replace(newest_sighting=time)], float(existence),
                            Source.SIGHT, detection.score)
        self._detect(2.0 * measurement.half_view * UNIFORM_DENSITY * target.detection_probability * image.visibility, fraction)
        self._reduce(time)

    @property
    def alone(self) -> bool:
        """Whether there is at most one drone, as far as is known."""
        return sum([track.is_drone and track.existence >= self._settings.confirmed for track in self.tracks]) < 2

    def _only(self, time: float, begin: bool) -> BernoulliTrack | None:
        """The drone from which a scan's only measurement of a drone stems if any does; None where there are several.

        One measurement shows no second target: it stems from this one, which may be elsewhere than assumed, or from an outlier.
        With `begin` it starts where there is none yet.
        """
        if not self.alone:
            return None
        drones = [track for track in self.tracks if track.is_drone]
        if not drones and begin:
            self._newest_id += 1
            drones = [BernoulliTrack(self._newest_id, time, self._settings, self._motion)]
            self.tracks += drones
        return max(drones, key=lambda track: track.existence, default=None)

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

    @staticmethod
    def _note(tracks: Sequence[BernoulliTrack], shares: NDArray[np.float64], sensor: Source, probabilities: Sequence[float],
              only: BernoulliTrack | None, *target: int, visibility: float = 1.0) -> None:
        """Note what the measurements of one scan tell of the kind of each track, and which tracks have different ones.

        Parameters:
            tracks, shares (t, m): probability of each measurement that it stems from each track.
            sensor, probabilities (m,): that each measured object is a drone.
            only, target: see `_only`, and the number of its measurement, 0 unless given.
            visibility: see `DroneEvidence.note`.
        """
        for track, row in zip(tracks, shares, strict=True):
            begins = track is only and not track.reported
            if begins:  # with this measurement
                row[list(target) or 0] = track.existence
            if sensor == Source.SIGHT or (begins and math.isnan(track.kind.probability)):  # else see `kinds_by_place`
                track.kind.note(sensor, probabilities, row.tolist(), visibility)
        measured = [(track, int(row.argmax())) for track, row in zip(tracks, shares, strict=True)
                    if row.size and row.max() >= ASSOCIATED]
        for (one, first), (other, second) in combinations(measured, 2):
            if first != second:
                one.told_apart[other.id] = other.told_apart[one.id] = one.time or 0.0

    def _reduce(self, time: float) -> None:
        """End tracks that hardly exist, and merge those that have been one and the same for some time."""
        kept: list[BernoulliTrack] = []
        alive = self._alive(time)
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
            track.reported = track.reported or track.existence >= self._settings.confirmed
            track.assume_alone(self.alone)

    def _alive(self, time: float) -> list[BernoulliTrack]:
        """Tracks that may exist, and the only drone: where it is lost, it may be anywhere, or another one comes."""
        alive = [track for track in self.tracks if track.existence >= self._settings.least_existence]
        lost = [track for track in self.tracks if track.is_drone and track not in alive]
        if lost and not any(track.is_drone for track in alive):
            last = max(lost, key=lambda track: track.existence)
            if last.reported:
                self._newest_id += 1
                last.renew(self._newest_id, time)
            alive.append(last)
        return alive

    def _are_one(self, first: BernoulliTrack, second: BernoulliTrack, time: float) -> bool:
        a, b, apart = first.mixture.primary(), second.mixture.primary(), first.told_apart.get(second.id)
        return (a is not None and b is not None and first.is_drone == second.is_drone and are_mergeable(a, b)
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
