"""Detections in a sequence of images: a detector, a tracker in the image, and the fusion of each track's scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import parse
from av_vision.camera_pose import CameraPose, turned
from av_vision.detections import Candidates, Detections
from av_vision.image import to_bgr8
from av_vision.motion import MotionModel
from av_vision.score_fusion import SINGLE_IMAGE, ScoreFusionModel, logit
from av_vision.search import FULL, BearingCue, Cue, RegionPlanner
from av_vision.tracking import ImageTrack, Tracker
from av_vision.yolo.detector import Detector
from av_vision.yolo.letterbox import Region, Turn

MOST_TRACKS = 4  # that are looked at for their own sake


class TemporalDetector:
    """A detector whose scores are fused over all images of an object.

    With a model that has `score_fusion` in its metadata, class and score of a detection are the posterior of its track, as far
    as it is likely the track's object, and boxes below the threshold can continue a track. With `motion` its path in the image
    counts, too. With other models, or without `temporal_fusion`, the tracker only numbers the detections of each image. An
    object is reported from its first image on.

    Parameters:
        detector: finds candidate boxes in one image.
        temporal_fusion: whether scores are fused over images.
        planner: selects the parts of each image that are searched; None searches all of it.

    Raises ValueError for an entry of `score_fusion` or `motion` that is unknown or outside its bounds.
    """

    def __init__(self, detector: Detector, temporal_fusion: bool = True, planner: RegionPlanner | None = None) -> None:
        self.detector = detector
        self.planner = planner or RegionPlanner(detector.model.longest, detector.model.near, FULL)
        stated = detector.model.metadata
        model = parse(ScoreFusionModel, stated.get('score_fusion', '{}'), 'score_fusion') if temporal_fusion else SINGLE_IMAGE
        # Without memory, boxes below the threshold are not used.
        floor = min(model.floor, detector.threshold) if model.memory_s else detector.threshold
        self.model: ScoreFusionModel = replace(model, floor=floor)
        # A threshold that the user sets holds for tracks, too.
        self._threshold = detector.settings.score_threshold or self.model.threshold or detector.threshold
        self._motion = parse(MotionModel, stated.get('motion', '{}'), 'motion') if self.model.memory_s else MotionModel()
        self._tracker = Tracker(self.model)
        self._shape: tuple[int, ...] | None = None
        self._pose: CameraPose | None = None

    def detect(self, image: NDArray, time: float, pose: CameraPose | None = None,
               bearing: BearingCue | None = None) -> tuple[Detections, list[int]]:
        """Detections in an image and their track numbers; `look` and `fuse` together."""
        candidates, regions = self.look(image, time, pose, bearing)
        return self.fuse(candidates, time, regions)

    def look(self, image: NDArray, time: float, pose: CameraPose | None = None,
             bearing: BearingCue | None = None) -> tuple[Candidates, Sequence[Region]]:
        """Candidates in an image and the regions in which they were searched, none for all of it.

        An image of another size, or earlier than the last, discards all tracks.

        Parameters:
            image (h, w[, channels]): BGR, grey or 16-bit.
            time (s): time of capture.
            pose: how the camera was turned then; None where that is not known.
            bearing: the fused bearing in the image.

        Raises ValueError for an array of another shape.
        """
        if image.shape[:2] != self._shape:
            self._tracker.reset()
            self._shape, self._pose = image.shape[:2], None
        if pose is not None and self._pose is not None:
            before = self._pose
            self._tracker.turn(lambda pixels: turned(pixels, before, pose))
        self._pose = pose
        regions = self.planner.plan(image.shape[:2], time, self._cues(time), bearing)
        return self._upright(image, regions, 0 if pose is None else pose.degrees_to_upright), regions

    def _upright(self, image: NDArray, regions: Sequence[Region], degrees: int) -> Candidates:
        """Candidates in an image that is searched upright: networks know no drones that fly on their side, or upside down.

        Parameters:
            image (h, w[, channels]): as the camera gives it.
            regions: of it, to be searched; none for all of it.
            degrees (deg): turn to the left that sets it upright.
        """
        if not degrees:
            return self.detector.candidates(image, self.model.floor, regions)
        height, width = image.shape[:2]
        turn = Turn(degrees, width, height)
        found = self.detector.candidates(turn.image(to_bgr8(image)), self.model.floor,
                                         [turn.region(region) for region in regions or self.detector.whole(height, width)])
        found = replace(found, boxes=turn.boxes(found.boxes))
        # The corners of the picture show nothing of the image.
        inside = ((found.centres >= 0.0) & (found.centres <= (width, height))).all(axis=1)
        return Candidates(found.boxes[inside], found.probabilities[inside])

    def fuse(self, candidates: Candidates, time: float, regions: Sequence[Region] = ()) -> tuple[Detections, list[int]]:
        """Detections and their track numbers from the candidates of an image.

        Parameters:
            candidates: candidates down to the floor of the model.
            time (s): time of capture.
            regions: parts of the image that were searched; none for all of it.
        """
        tracks = self._tracker.update(candidates, time)
        followed = [(k, track) for k, track in enumerate(tracks) if track is not None]
        for track in self._tracker.tracks:
            if track.time == time or not regions or any(
                    region.holds(track.predicted(time), float(track.size.max())) for region in regions):
                track.looked = time
        posterior = np.array([self._posterior(track, time, candidates.probabilities[k]) for k, track in followed])
        fused = Candidates(candidates.boxes[[k for k, _ in followed]],
                           posterior.reshape(-1, candidates.probabilities.shape[1]))
        detections, selected = self.detector.select(fused, self._threshold)
        return detections, [self._tracker.number(followed[k][1]) for k in selected]

    def _posterior(self, track: ImageTrack, time: float, own: NDArray) -> NDArray[np.float64]:
        """Probabilities (classes,) of a box: its track's as far as it is the track's object's, else its `own` (classes,).

        Those of the track follow from its scores and, of classes that are reported, its motion.
        """
        track.path.add(time, track.centre, float((track.size - self.detector.model.box_padding).max()))
        fused = track.probabilities
        moved = 1.0 / (1.0 + np.exp(-logit(fused) - self._motion.log_odds(track.path)))
        of_track = np.where(self.detector.kept, moved, fused)
        return track.continued * of_track + (1.0 - track.continued) * own

    def searched(self, time: float) -> bool:
        """Whether the image of a capture time (s) could have shown every object: nothing else makes their absence evidence.

        All of it was searched within the last seconds, each track that was or may be reported was looked for in this very
        image, and none that it shows is withheld for its motion alone.
        """
        for track in self._tracker.tracks:
            likely = self._is_likely(track)
            if ((track.id or likely) and track.looked < time) or (likely and track.time == time):
                return False
        return self.planner.searched(time)

    def _is_likely(self, track: ImageTrack) -> bool:
        """Whether a track would be reported if it were not for its motion."""
        fused = track.probabilities
        return bool(self.detector.kept[fused.argmax()] and fused.max() > self._threshold)

    def _cues(self, time: float) -> list[Cue]:
        """Where tracks are expected, those that are most likely of a class to report first."""
        ranked = sorted(self._tracker.tracks, key=lambda track: -track.probabilities[self.detector.kept].max())
        return [Cue(track.predicted(time), float(track.size.max()), time - track.looked, self._is_likely(track))
                for track in ranked[:MOST_TRACKS]]

    def reset(self) -> None:
        """Discard all tracks; their numbers are not used again."""
        self._tracker.reset()
        self.planner.reset()
