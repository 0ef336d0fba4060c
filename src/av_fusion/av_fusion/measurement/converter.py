"""What the senses say as measurements in the body frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_fusion.measurement.geometry import detections_in_body, look_in_body, sounds_in_body
from av_fusion.measurement.measurements import Detection, Look, Sound
from av_fusion.measurement.readings import Heard, Seen

EMPTY = np.empty((0, 2))


class Senses:
    """Turns directions of arrival and detections; `rotation_of` gives a frame's rotation into the body's, or None.

    Without a `camera` there are sounds only.
    """

    def __init__(self, rotation_of: Callable[[str], NDArray | None], target_classes: Sequence[str],
                 camera: PinholeCamera | None) -> None:
        self._rotation_of = rotation_of
        self._target_classes = frozenset(target_classes)
        self.camera = camera

    @property
    def camera(self) -> PinholeCamera | None:
        """The camera that took the pictures."""
        return self._camera

    @camera.setter
    def camera(self, camera: PinholeCamera | None) -> None:
        self._camera = camera
        self._empty: dict[str, Look] = {}  # by frame
        self._found: dict[int, tuple[Detection, ...]] = {}  # by picture

    def sounds(self, heard: Heard, least_confidence: float = 0.0) -> list[Sound]:
        """The sounds of a window, strongest first; none where their frame is unknown."""
        found = [direction for direction in heard.directions if direction.confidence >= least_confidence]
        rotation = self._rotation_of(heard.frame) if found else None
        if rotation is None:
            return []
        return sounds_in_body(
            heard.time, [direction[:3] for direction in found], [direction.azimuth_variance for direction in found],
            [direction.elevation_variance for direction in found], [direction.confidence for direction in found],
            [direction.group for direction in found], rotation, heard.window)

    def look(self, seen: Seen, visibility: float = math.nan) -> Look | None:
        """The detections of the target's classes in a picture; None where frame or camera are unknown."""
        rotation = self._rotation_of(seen.frame) if self.camera is not None else None
        if rotation is None:
            return None
        empty = self._empty.get(seen.frame)
        if empty is None:
            empty = self._empty[seen.frame] = look_in_body(0.0, self.camera, EMPTY, EMPTY, EMPTY[:, 0], rotation)
        found = self._found.get(id(seen))
        if found is None:
            found = self._detections([seen], rotation)[0] if seen.boxes else ()
        return Look(seen.time, found, empty.view_azimuth, empty.half_view, visibility)

    def look_ahead(self, several: Sequence[Seen]) -> None:
        """Find the directions in many pictures at once, in a tenth of the time; `look` then knows them until the next call."""
        self._found.clear()
        for frame in {seen.frame for seen in several if seen.boxes} if self.camera is not None else ():
            rotation = self._rotation_of(frame)
            if rotation is not None:
                alike = [seen for seen in several if seen.frame == frame]
                self._found.update(zip(map(id, alike), self._detections(alike, rotation), strict=True))

    def _detections(self, several: Sequence[Seen], rotation: NDArray) -> list[tuple[Detection, ...]]:
        """Detections of the target's classes, by picture."""
        boxes, counts = [], []
        for seen in several:
            before = len(boxes)
            for box in seen.boxes:
                scores = [score for name, score in box.scores if name in self._target_classes]
                if scores:
                    boxes.append((box.x, box.y, box.width, box.height, max(scores)))
            counts.append(len(boxes) - before)
        if not boxes:  # most pictures of a search: nothing to be computed
            return [()] * len(several)
        table = np.array(boxes)
        found = iter(detections_in_body(self.camera, table[:, :2], table[:, 2:4], table[:, 4], rotation))
        return [tuple(islice(found, count)) for count in counts]
