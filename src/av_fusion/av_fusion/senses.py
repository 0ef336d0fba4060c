"""Messages of the senses, of whatever library, as measurements in the body frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_common.stamps import to_seconds
from av_fusion.measurements import Look, Sound
from av_fusion.sensor_geometry import look_in_body, sounds_in_body
from av_vision.camera import PinholeCamera

EMPTY = np.empty((0, 2))


class Senses:
    """Reads directions of arrival and detections; `rotation_of` gives a frame's rotation into the body's, or None.

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

    def sounds(self, message: Any, least_confidence: float = 0.0) -> list[Sound]:
        """The sounds of a DoaArray, strongest first; none where their frame is unknown."""
        found = [h for h in message.hypotheses if h.confidence >= least_confidence]
        rotation = self._rotation_of(message.header.frame_id) if found else None
        if rotation is None:
            return []
        return sounds_in_body(
            to_seconds(message.header.stamp), [(h.direction.x, h.direction.y, h.direction.z) for h in found],
            [h.azimuth_variance for h in found], [h.elevation_variance for h in found], [h.confidence for h in found],
            [h.ambiguity_group for h in found], rotation, message.window)

    def look(self, message: Any, visibility: float = math.nan) -> Look | None:
        """The detections of the target's classes of a Detection2DArray; None where frame or camera are unknown."""
        if self.camera is None:
            return None
        seconds, frame = to_seconds(message.header.stamp), message.header.frame_id
        rotation = self._rotation_of(frame)
        if rotation is None:
            return None
        if frame not in self._empty:
            self._empty[frame] = look_in_body(0.0, self.camera, EMPTY, EMPTY, EMPTY[:, 0], rotation)
        boxes = []
        for detection in message.detections:
            scores = [result.hypothesis.score for result in detection.results
                      if result.hypothesis.class_id in self._target_classes]
            if scores:
                box = detection.bbox
                boxes.append((box.center.position.x, box.center.position.y, box.size_x, box.size_y, max(scores)))
        if not boxes:  # most pictures of a search: nothing to be computed
            empty = self._empty[frame]
            return Look(seconds, (), empty.view_azimuth, empty.half_view, visibility)
        table = np.array(boxes)
        return look_in_body(seconds, self.camera, table[:, :2], table[:, 2:4], table[:, 4],
                            rotation, visibility)
