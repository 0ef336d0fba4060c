"""What a detector saw in one picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray


class Boxes:
    """What every set of boxes (n, 4) as x1, y1, x2, y2 in pixels of the picture has."""

    boxes: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.boxes)

    @cached_property
    def centres(self) -> NDArray[np.float32]:
        """Centres (n, 2) in pixels."""
        return 0.5 * (self.boxes[:, :2] + self.boxes[:, 2:])

    @cached_property
    def sizes(self) -> NDArray[np.float32]:
        """Widths and heights (n, 2) in pixels."""
        return self.boxes[:, 2:] - self.boxes[:, :2]


@dataclass(frozen=True)
class Detections(Boxes):
    """Boxes, scores (n,) in 0-1 in falling order, n class names."""

    boxes: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 4), np.float32))
    scores: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    class_names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Candidates(Boxes):
    """Everything that might be something: boxes, probabilities (n, classes) 0-1."""

    boxes: NDArray[np.float32]
    probabilities: NDArray[np.floating]

    @cached_property
    def scores(self) -> NDArray[np.floating]:
        """Of the likeliest class (n,)."""
        return self.probabilities.max(axis=1, initial=0.0)


def suppress(boxes: NDArray, scores: NDArray, iou: float, nested: float = 1.0) -> NDArray[np.intp]:
    """Indices of the boxes that survive non-maximum suppression, by falling score.

    Boxes are (n, 4) x1, y1, x2, y2. Of two that overlap by more than `iou`, or of which more than the share `nested` of the
    smaller lies in the other, the less likely goes. Classes compete: what stands in one place is one thing, and a likely
    bird is no drone.
    """
    if not len(boxes):
        return np.empty(0, np.intp)
    xywh = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1).astype(np.float64)
    chosen = np.asarray(cv2.dnn.NMSBoxes(xywh, scores.astype(np.float32), 0.0, iou), np.intp).reshape(-1)
    if nested >= 1.0 or len(chosen) < 2:
        return chosen
    left = boxes[chosen]
    low, high = np.maximum(left[:, None, :2], left[None, :, :2]), np.minimum(left[:, None, 2:], left[None, :, 2:])
    area = np.prod(left[:, 2:] - left[:, :2], axis=1)
    inside = np.clip(high - low, 0.0, None).prod(axis=2) > nested * np.minimum(area[:, None], area[None])
    stands = np.ones(len(left), bool)
    for k in range(1, len(left)):
        stands[k] = not (inside[k, :k] & stands[:k]).any()
    return chosen[stands]
