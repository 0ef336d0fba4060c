"""Boxes, scores and classes of the objects detected in one image."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

IOU, NESTED = 0.5, 0.6    # largest intersection over union of two objects, and share of the smaller one in the other


class Boxes:
    """Boxes (n, 4) as x1, y1, x2, y2 in pixels of the image."""

    boxes: NDArray[np.floating]

    def __len__(self) -> int:
        return len(self.boxes)

    @cached_property
    def centres(self) -> NDArray[np.floating]:
        """Centres (n, 2) in pixels."""
        return np.asarray(0.5 * (self.boxes[:, :2] + self.boxes[:, 2:]))

    @cached_property
    def sizes(self) -> NDArray[np.floating]:
        """Widths and heights (n, 2) in pixels."""
        return np.asarray(self.boxes[:, 2:] - self.boxes[:, :2])


@dataclass(frozen=True)
class Detections(Boxes):
    """Result of a detector.

    Parameters:
        boxes (n, 4; pixels): x1, y1, x2, y2.
        scores (n,; 0-1): scores in falling order.
        class_names: name of the class of each detection.
    """

    boxes: NDArray[np.floating] = field(default_factory=lambda: np.empty((0, 4), np.float32))
    scores: NDArray[np.floating] = field(default_factory=lambda: np.empty(0, np.float32))
    class_names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Candidates(Boxes):
    """Boxes above a floor, before classes and threshold are applied.

    Parameters:
        boxes (n, 4; pixels): x1, y1, x2, y2.
        probabilities (n, classes; 0-1): probability of each class.
    """

    boxes: NDArray[np.floating]
    probabilities: NDArray[np.floating]

    @cached_property
    def scores(self) -> NDArray[np.floating]:
        """Probabilities (n,) of the most probable class."""
        return np.asarray(self.probabilities.max(axis=1, initial=0.0))


def suppress(boxes: NDArray, scores: NDArray) -> NDArray[np.intp]:
    """Indices of the boxes that remain after non-maximum suppression over all classes, by falling score.

    Classes compete, because there is only one object in one place. Of two boxes that overlap by more than IOU, or of which more
    than NESTED of the smaller one is in the other, that of the lower score is removed.

    Parameters:
        boxes (n, 4) (pixels): x1, y1, x2, y2.
        scores (n,): scores of the boxes.
    """
    if not len(boxes):
        return np.empty(0, np.intp)
    xywh = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1).astype(np.float64)
    selected = np.asarray(cv2.dnn.NMSBoxes(xywh, scores.astype(np.float32), 0.0, IOU), np.intp).reshape(-1)  # type: ignore[arg-type]
    left = boxes[selected]
    low, high = np.maximum(left[:, None, :2], left[None, :, :2]), np.minimum(left[:, None, 2:], left[None, :, 2:])
    area = np.prod(left[:, 2:] - left[:, :2], axis=1)
    inside = np.clip(high - low, 0.0, None).prod(axis=2) > NESTED * np.minimum(area[:, None], area[None])
    kept = np.ones(len(left), bool)
    for k in range(1, len(left)):
        kept[k] = not (inside[k, :k] & kept[:k]).any()
    return np.asarray(selected[kept])
