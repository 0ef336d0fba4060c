"""Detections in a sequence of images: a detector, a tracker in the image, and the fusion of each track's scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_vision.detections import Candidates, Detections
from av_vision.score_fusion import SINGLE_IMAGE, ScoreFusionModel
from av_vision.tracking import Tracker
from av_vision.yolo.detector import Detector


class TemporalDetector:
    """A detector whose scores are fused over all images of an object.

    With a model that has `score_fusion` in its metadata, class and score of a detection are the posterior of its track, and
    boxes below the threshold can continue a track. With other models, or without `temporal_fusion`, the tracker only numbers
    the detections of each image. An object is reported from its first image on.

    Parameters:
        detector: finds candidate boxes in one image.
        max_gap_s (s): time for which a track is kept without a detection.
        temporal_fusion: whether scores are fused over images.
    """

    def __init__(self, detector: Detector, max_gap_s: float = 1.0, temporal_fusion: bool = True) -> None:
        self.detector = detector
        model = ScoreFusionModel.from_metadata(detector.model.metadata) if temporal_fusion else SINGLE_IMAGE
        # Without memory, boxes below the threshold are not used.
        self.model = replace(model, floor=min(model.floor, detector.threshold) if model.memory_s else detector.threshold)
        self._tracker = Tracker(max_gap_s, self.model)
        self._shape: tuple[int, ...] | None = None

    def detect(self, image: NDArray, time: float) -> tuple[Detections, list[int]]:
        """Detections in an image and their track numbers.

        An image of another size, or earlier than the last, discards all tracks.

        Parameters:
            image (h, w[, channels]): BGR, grey or 16-bit.
            time (s): time of capture.

        Raises ValueError for an array of another shape.
        """
        candidates = self.detector.candidates(image, self.model.floor)
        if image.shape[:2] != self._shape:
            self._tracker.reset()
            self._shape = image.shape[:2]
        return self.fuse(candidates, time)

    def fuse(self, candidates: Candidates, time: float) -> tuple[Detections, list[int]]:
        """As `detect`, from the candidates of an image.

        Parameters:
            candidates: candidates down to the floor of the model.
            time (s): time of capture.
        """
        tracks = self._tracker.update(candidates, time)
        followed = [(k, track) for k, track in enumerate(tracks) if track is not None]
        posterior = np.array([track.scores.probabilities() for _, track in followed])
        fused = Candidates(candidates.boxes[[k for k, _ in followed]],
                           posterior.reshape(-1, candidates.probabilities.shape[1]))
        detections, selected = self.detector.select(fused)
        return detections, [self._tracker.number(followed[k][1]) for k in selected]

    def reset(self) -> None:
        """Discard all tracks; their numbers are not used again."""
        self._tracker.reset()
