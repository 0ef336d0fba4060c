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
    """A detector whose scores come from all images of an object.

    With a model whose metadata has `score_fusion`, class and score of a detection are its track's posterior, and boxes below
    the threshold continue the track of an object above it. With other models, or without `temporal_fusion`, the tracker only
    numbers the detections of each image. The first image of an object is reported at once, with its own score.

    Parameters:
        detector: finds candidate boxes in one image.
        max_gap_s (s): time for which a track lives without a detection.
        temporal_fusion: whether scores are fused over images.
    """

    def __init__(self, detector: Detector, max_gap_s: float = 1.0, temporal_fusion: bool = True) -> None:
        self.detector = detector
        model = ScoreFusionModel.from_metadata(detector.model.metadata) if temporal_fusion else SINGLE_IMAGE
        # Without memory, boxes below the threshold are of no use.
        self.model = replace(model, floor=min(model.floor, detector.threshold) if model.memory_s else detector.threshold)
        self._tracker = Tracker(max_gap_s, self.model)
        self._shape: tuple[int, ...] | None = None

    def detect(self, image: NDArray, time: float) -> tuple[Detections, list[int]]:
        """Detections in an image and their track numbers.

        An image of another size, or earlier than the last, discards all tracks. Raises ValueError for an array that is no
        image.

        Parameters:
            image (h, w[, channels]): BGR, grey or 16-bit.
            time (s): of capture.
        """
        candidates = self.detector.candidates(image, self.model.floor)
        if image.shape[:2] != self._shape:
            self._tracker.reset()
            self._shape = image.shape[:2]
        return self.fuse(candidates, time)

    def fuse(self, candidates: Candidates, time: float) -> tuple[Detections, list[int]]:
        """The same from the candidates of an image down to the model's floor, taken at `time` (s)."""
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
