"""A multi-Bernoulli filter: marginal data association with existence, births from measurements that no track explains."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from av_common.track import Source
from av_fusion.identity.blade_pass import fundamental_likelihoods
from av_fusion.identity.kind import OWN
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows
from av_fusion.tracks.association import Association, associate
from av_fusion.tracks.component import ASSOCIATED, SOUND
from av_fusion.tracks.likelihood import UNIFORM_DENSITY, Comparison, Hearing, WorldCone, WorldDirections, hear
from av_fusion.tracks.mixture import are_mergeable
from av_fusion.tracks.past_state import Lag
from av_fusion.tracks.settings import FilterSettings
from av_fusion.tracks.sight import Image, odds_of
from av_fusion.tracks.track import Track, audible, presence

LOOK_S = 1.0  # of sound, by which `Doa.drone_probability` is judged


class MultiBernoulliFilter:
    """Tracks with existence probabilities, and a uniform Poisson process of targets that were not detected yet.

    The track-oriented marginal filter of Williams, Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA, and
    association-based MeMBer, IEEE Transactions on Aerospace and Electronic Systems 51(3), 2015. One target is updated as one of
    several are.

    Attributes:
        tracks: in the order of their ids.
        newest, newest_doa (s): newest capture times of any measurement, and of a window of sound.

    Parameters:
        settings: see `FilterSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, settings: FilterSettings, motion: RigMotion) -> None:
        self._settings, self._motion = settings, motion
        self._newest_id = 0
        self.reset()

    def reset(self) -> None:
        """Discard all tracks; their ids are not used again."""
        self.tracks: list[Track] = []
        # By the ids of two tracks: newest time (s) at which they had different measurements in a scan.
        self._told_apart: dict[tuple[int, int], float] = {}
        self.newest = self.newest_doa = -math.inf
        # Of each camera: the errors of one tell nothing about those of another.
        self._newest_image: defaultdict[str, float] = defaultdict(lambda: -math.inf)
        self._newest_sighting = self._newest_image.copy()
        self._undetected = self._settings.undetected_first

    def turn_world(self, rows: Rows) -> None:
        """Turn all tracks with the world, where the rig's attitude was corrected."""
        for track in self.tracks:
            track.turn_world(rows)

    @property
    def confirmed(self) -> list[Track]:
        """The tracks that are reported."""
        return [track for track in self.tracks if track.existence >= self._settings.confirmed]

    def update_sound(self, time: float, measurements: Sequence[DoaMeasurement]) -> None:
        """Update by the directions of arrival of one window.

        Parameters:
            time (s): its capture time.
            measurements: directions in the body frame, of different sources; at least one.
        """
        length = max([one.window for one in measurements])
        fraction = effective_sample_fraction(time, self.newest_doa, length)
        look = effective_sample_fraction(time, self.newest_doa, LOOK_S)
        elapsed = max(time - self.newest_doa, 0.0)
        heard = [hear(time, one, self._settings, self._motion) for one in measurements]
        mirrors = {one.mirror for one in heard if one.mirror is not None}
        places = [track.predict(time, mirrors) for track in self.tracks]
        for track in self.tracks:
            track.blade_pass.predict(elapsed)
        self.newest_doa, self.newest = max(self.newest_doa, time), max(self.newest, time)
        self._use_sound(time, measurements, heard, places, fraction, look, min(elapsed, LOOK_S))
        self._detect(self._settings.sound_detection_probability, fraction)
        self._reduce(time)

    def _use_sound(self, time: float, measurements: Sequence[DoaMeasurement], heard: Sequence[Hearing],
                   places: Sequence[Lag], fraction: float, look: float, elapsed: float) -> None:
        """Associate the directions with the tracks, update these, and begin tracks for what none explains."""
        detected, kinds = self._settings.sound_detection_probability, [one.drone_probability for one in measurements]
        gains = np.array([detected * one.peak / one.clutter for one in heard])
        fundamentals = fundamental_likelihoods(measurements)
        compared = [track.compare_sound(time, heard, place) for track, place in zip(self.tracks, places, strict=True)]
        compared = [audible(each, gains, chance) for each, chance in zip(compared, self._chances(compared), strict=True)]
        voices = np.array([track.blade_pass.fits(fundamentals) * track.kind.fits(kinds) for track in self.tracks]
                          ).reshape(len(compared), len(heard))
        voices /= np.maximum.reduce(voices, initial=1.0)  # an echo sounds alike: only other targets are excluded
        free, shares, new = self._associate(compared, np.array([one.odds for one in heard]), voices)
        for track, each, factors, row in zip(self.tracks, compared, free, shares, strict=True):
            if each:
                track.use_sound(time, each, gains, factors, fraction)
            track.blade_pass.update(fundamentals, row, fraction)
            track.note_kind(Source.SOUND, kinds, (row * look).tolist(), elapsed * float(np.add.reduce(row)))
        for j, existence in enumerate((fraction * new).tolist()):
            begun = self._begin(time, heard[j].source, existence, OWN)
            if begun is not None:
                for component in begun.mixture.components:
                    component.newest_doa, component.hidden = time, {SOUND: (0.0, time)}
                begun.blade_pass.update(fundamentals[j:j + 1], np.ones(1), fraction)
                begun.note_kind(Source.SOUND, kinds[j:j + 1], [1.0])

    def _chances(self, compared: Sequence[Sequence[Comparison]]) -> list[float]:
        """Probability of each track that it is among the directions if it can be heard: another one may mask it."""
        detected, present = self._settings.sound_detection_probability, [presence(each) for each in compared]
        return [detected * (1.0 - self._settings.masked * max(present[:k] + present[k + 1:], default=0.0))
                for k in range(len(present))]

    def _associate(self, compared: Sequence[Sequence[Comparison]], odds: NDArray[np.float64],
                   voices: NDArray[np.float64] | float = 1.0) -> Association:
        """Which track each measurement of a scan stems from, by the existence of new ones as `unclaimed`.

        Parameters:
            compared: of the tracks' components with the scan.
            odds (m,): that each measurement stems from a source rather than from none.
            voices (t, m): how well each measurement sounds like each track.
        """
        odds = self._undetected * odds
        ratios = np.array([track.ratios(each, len(odds)) for track, each in zip(self.tracks, compared, strict=True)])
        free, shares, unclaimed = associate(ratios.reshape(len(compared), len(odds)) * voices, 1.0 + odds)
        self._note_told_apart(shares)
        return Association(free * voices, shares, unclaimed * odds / (1.0 + odds))

    def update_image(self, time: float, measurement: CameraMeasurement) -> None:
        """Update by an image.

        Parameters:
            time (s): its capture time.
            measurement: the image's detections in the body frame.
        """
        settings, detections, camera = self._settings, measurement.detections, measurement.camera
        newest = self._newest_sighting if detections else self._newest_image
        fraction = effective_sample_fraction(time, newest[camera], settings.sight_correlation)
        self._newest_image[camera], self.newest = max(self._newest_image[camera], time), max(self.newest, time)
        places = [track.predict(time) for track in self.tracks]
        image = Image.of(time, measurement, self._motion.attitude(time), settings.assumed_visibility, fraction)
        compared = [track.compare_image(image, place) for track, place in zip(self.tracks, places, strict=True)]
        free, shares, new = self._associate(compared, np.array([odds_of(detection) for detection in detections]))
        for track, each, factors, row in zip(self.tracks, compared, free, shares.tolist(), strict=True):
            supporting = [one.score for one, share in zip(detections, row, strict=True) if share > ASSOCIATED]
            track.score = max(supporting, default=0.0)
            track.use_image(image, each, factors)
        if detections:
            self._newest_sighting[camera] = max(self._newest_sighting[camera], time)
            scores = [detection.score for detection in detections]
            clear = measurement.visibility if math.isfinite(measurement.visibility) else 1.0  # fog lowers scores
            for track, row in zip(self.tracks, shares, strict=True):
                track.note_kind(Source.SIGHT, scores, (fraction * clear * row).tolist())
            for detection, direction, existence in zip(detections, image.directions, new.tolist(), strict=True):
                begun = self._begin(time, WorldDirections([direction]), existence)
                if begun is not None:
                    for component in begun.mixture.components:
                        component.newest_sighting, component.hidden = time, {camera: (0.0, time)}
                    begun.score = detection.score
                    begun.note_kind(Source.SIGHT, [detection.score], [clear])
        view_share = measurement.searched * 2.0 * measurement.half_view * UNIFORM_DENSITY
        self._detect(view_share * settings.detection_probability * image.visibility, fraction)
        self._reduce(time)

    def _begin(self, time: float, source: WorldCone | WorldDirections, existence: float, on_rig: float = 0.0) -> Track | None:
        """Begin a track with a measurement that no track explains; None where it hardly is a target.

        Parameters:
            time (s): capture time of the measurement.
            source: the measurement in the world.
            existence: probability that it is a target.
            on_rig: probability that such a target turns with the rig.
        """
        births = source.births(self._settings) if existence >= self._settings.least_existence else []
        if not births:
            return None
        self._newest_id += 1
        track = Track(self._newest_id, time, births, existence, self._settings, self._motion, on_rig)
        self.tracks.append(track)
        return track

    def _detect(self, probability: float, fraction: float) -> None:
        """Fewer targets are left that were not detected, although they could have been."""
        usual = self._settings.undetected
        self._undetected = usual + (self._undetected - usual) * (1.0 - probability) ** fraction

    def _note_told_apart(self, shares: NDArray[np.float64]) -> None:
        """Note which tracks have different measurements of one scan, by the probabilities (t, m) that they are theirs."""
        measured = [(track, int(row.argmax())) for track, row in zip(self.tracks, shares, strict=True)
                    if row.size and row.max() >= ASSOCIATED]
        for (one, first), (other, second) in combinations(measured, 2):
            if first != second:
                self._told_apart[one.id, other.id] = one.time

    def _reduce(self, time: float) -> None:
        """End tracks that hardly exist, and merge those that have been one and the same for some time."""
        kept: list[Track] = []
        alive = [track for track in self.tracks if track.existence >= self._settings.least_existence]
        for track in sorted(alive, key=lambda each: -each.existence)[:self._settings.most_tracks]:
            other = next((other for other in kept if self._are_one(other, track, time)), None)
            if other is None:
                kept.append(track)
            else:
                kept[kept.index(other)] = _united(other, track)
        self.tracks = sorted(kept, key=lambda track: track.id)
        ids = {track.id for track in self.tracks}
        self._told_apart = {pair: at for pair, at in self._told_apart.items() if ids.issuperset(pair)}

    def _are_one(self, first: Track, second: Track, time: float) -> bool:
        pair = min(first.id, second.id), max(first.id, second.id)
        a, b, apart = first.mixture.primary(), second.mixture.primary(), self._told_apart.get(pair)
        return (a is not None and b is not None and are_mergeable(a, b)
                and (apart is None or time - apart > self._settings.duplicate_time))


def _united(one: Track, other: Track) -> Track:
    """One track of two of one target, under the older id.

    The united density is the more certain one as far as its target exists, and else the other. The heavier part is kept.
    """
    first, second = sorted((one, other), key=lambda each: each.mixture.entropy)
    if first.existence < second.existence * first.mixture.absent:
        first, second = second, first
    first.mixture.absent *= second.mixture.absent
    first.mixture.reduce()
    if second.id < first.id:
        first.id, first.began = second.id, second.began
    return first


def effective_sample_fraction(time: float, newest: float, correlation: float) -> float:
    """Share of a measurement that is new evidence, when errors are correlated over `correlation` s.

    Parameters:
        time (s): capture time of the measurement.
        newest (s): capture time of the newest earlier measurement.
        correlation (s): correlation time of the errors.
    """
    return min(1.0, max(abs(time - newest) / correlation, 0.02))
