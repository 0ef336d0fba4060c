"""What the senses say as measurements in the body frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurements import Look, Sound
from av_fusion.readings import Heard, Seen
from av_fusion.sensor_geometry import look_in_body, sounds_in_body
from av_vision.camera import PinholeCamera

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
        if self.camera is None:
            return None
        rotation = self._rotation_of(seen.frame)
        if rotation is None:
            return None
        boxes = []
        for box in seen.boxes:
            scores = [score for name, score in box.scores if name in self._target_classes]
            if scores:
                boxes.append((box.x, box.y, box.width, box.height, max(scores)))
        if not boxes:  # most pictures of a search: nothing to be computed
            empty = self._empty.get(seen.frame)
            if empty is None:
                empty = self._empty[seen.frame] = look_in_body(0.0, self.camera, EMPTY, EMPTY, EMPTY[:, 0], rotation)
            return Look(seen.time, (), empty.view_azimuth, empty.half_view, visibility)
        table = np.array(boxes)
        return look_in_body(seen.time, self.camera, table[:, :2], table[:, 2:4], table[:, 4], rotation, visibility)
