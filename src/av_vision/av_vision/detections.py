"""Boxes, scores and classes of the objects detected in one image."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

NESTED = 0.6    # largest share of the smaller of two objects in the other; less than what is common at an IoU of 0.5


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

    Classes compete, because there is only one object in one place. Of two boxes of which more than NESTED of the smaller one is
    in the other, that of the lower score is removed.

    Parameters:
        boxes (n, 4) (pixels): x1, y1, x2, y2.
        scores (n,): scores of the boxes.
    """
    left, kept = np.argsort(-scores, kind='stable'), []
    left = left[scores[left] > 0.0]
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    while len(left):
        best, left = left[0], left[1:]
        kept.append(best)
        low, high = np.maximum(boxes[left, :2], boxes[best, :2]), np.minimum(boxes[left, 2:], boxes[best, 2:])
        common = np.clip(high - low, 0.0, None).prod(axis=1)
        left = left[common <= NESTED * np.minimum(area[left], area[best])]
    return np.array(kept, np.intp)
