"""Pictures one after another: the way in which node, program and replay look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_vision.evidence import STILL, EvidenceModel
from av_vision.tracking import Tracker
from av_vision.yolo.detections import Candidates, Detections
from av_vision.yolo.detector import Detector


class Watcher:
    """A detector with a memory: what is reported of a thing comes from all pictures of it.

    For models that say how (metadata `evidence`) a detection's class and score are its track's posterior, and boxes too
    weak by themselves continue the track of a sure thing. With other models, and with `still`, the tracker only numbers
    what each picture shows. The first picture of a thing is judged at once, by itself.
    """

    def __init__(self, detector: Detector, max_gap_s: float = 1.0, still: bool = False) -> None:
        self._detector = detector
        model = STILL if still else EvidenceModel.from_metadata(detector.model.metadata)
        # Without memory, weaker boxes than the threshold are of no use.
        self.model = replace(model, floor=min(model.floor, detector.threshold) if model.memory_s else detector.threshold)
        self._tracker = Tracker(max_gap_s, self.model)
        self._shape: tuple[int, ...] | None = None

    def look(self, image: NDArray, time: float) -> tuple[Detections, list[int]]:
        """Detections in a picture taken at a time in s, and their track numbers; raises ValueError for what is no picture.

        A picture of another size, or from before the last, begins anew.
        """
        seen = self._detector.candidates(image, self.model.floor)
        if image.shape[:2] != self._shape:
            self._tracker.forget()
            self._shape = image.shape[:2]
        return self.judge(seen, time)

    def judge(self, seen: Candidates, time: float) -> tuple[Detections, list[int]]:
        """The same from what the network saw down to the model's floor."""
        tracks = self._tracker.update(seen, time)
        followed = [k for k, track in enumerate(tracks) if track is not None]
        judged = np.array([tracks[k].evidence.probabilities() for k in followed]).reshape(-1, seen.probabilities.shape[1])
        found, chosen = self._detector.report(Candidates(seen.boxes[followed], judged))
        return found, [self._tracker.number(tracks[followed[k]]) for k in chosen]
