"""What the senses say as measurements in the body frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.stamps import to_seconds
from av_fusion.measurement.geometry import detections_in_body, look_in_body, sounds_in_body
from av_fusion.measurement.measurements import Detection, Look, Sound

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

    def sounds(self, message: Any, least_confidence: float = 0.0) -> list[Sound]:
        """The sounds of a DoaArray, strongest first; none where their frame is unknown."""
        found = [hypothesis for hypothesis in message.hypotheses if hypothesis.confidence >= least_confidence]
        rotation = self._rotation_of(message.header.frame_id) if found else None
        if rotation is None:
            return []
        return sounds_in_body(
            to_seconds(message.header.stamp), [(h.direction.x, h.direction.y, h.direction.z) for h in found],
            [h.azimuth_variance for h in found], [h.elevation_variance for h in found], [h.confidence for h in found],
            [h.ambiguity_group for h in found], rotation, message.window)

    def look(self, message: Any, visibility: float = math.nan) -> Look | None:
        """The detections of the target's classes in a Detection2DArray; None where frame or camera are unknown."""
        frame = message.header.frame_id
        rotation = self._rotation_of(frame) if self.camera is not None else None
        if rotation is None:
            return None
        empty = self._empty.get(frame)
        if empty is None:
            empty = self._empty[frame] = look_in_body(0.0, self.camera, EMPTY, EMPTY, EMPTY[:, 0], rotation)
        return Look(to_seconds(message.header.stamp), self._detections(message, rotation), empty.view_azimuth,
                    empty.half_view, visibility)

    def _detections(self, message: Any, rotation: NDArray) -> tuple[Detection, ...]:
        boxes = []
        for detection in message.detections:
            hypotheses = [result.hypothesis for result in detection.results]
            scores = [h.score for h in hypotheses if h.class_id in self._target_classes]
            if scores:
                box = detection.bbox
                boxes.append((box.center.position.x, box.center.position.y, box.size_x, box.size_y, max(scores)))
        if not boxes:  # most images of a search: nothing to compute
            return ()
        table = np.array(boxes)
        return tuple(detections_in_body(self.camera, table[:, :2], table[:, 2:4], table[:, 4], rotation))
