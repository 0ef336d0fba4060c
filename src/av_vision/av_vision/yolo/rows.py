"""Tables of boxes, one in each row: which column is what is found by the values.

Exports without cells agree in little: YOLOv10 and 26 give corners in pixels, score and class, RT-DETR (Zhao et al. 2023,
arXiv:2304.08069) centre and size in shares of the input and a score for each class, others an order of their own. A reading
that an output contradicts is dropped; of those that are left the most usual counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Decoded = tuple[NDArray[np.float32], NDArray[np.float32]]  # boxes (n, 4), probabilities (n, classes)
SHARES = 2.0            # boxes whose values are all below it are in shares of the input: in pixels they would be specks
TOLERANCE = 2e-3        # of a score beyond 0 and 1, and of a box in shares of the input: float16
OUTSIDE = 0.25          # share of the input by which boxes may reach beyond it
GARBAGE = 0.1           # share of the rows, of no score, whose boxes may be none: a regression without bounds


class LayoutError(ValueError):
    """The output is not that of a known YOLO export."""


def corners(centre: NDArray, size: NDArray) -> NDArray[np.float32]:
    """Boxes (n, 4) x1, y1, x2, y2 from centres and sizes (n, 2).

    Parameters:
        centre (n, 2): centres.
        size (n, 2): widths and heights.
    """
    return np.concatenate([centre - 0.5 * size, centre + 0.5 * size], axis=1)


def check_scores(scores: NDArray) -> None:
    """Raise LayoutError where scores of any shape are none: all NaN, or beyond 0 to 1. Single NaN and infinite ones may be."""
    finite = scores[np.isfinite(scores)]
    if scores.size and not finite.size:
        raise LayoutError('no score is a finite number, expected 0 to 1')
    low, high = finite.min(initial=0.0), finite.max(initial=0.0)
    if low < -TOLERANCE or high > 1.0 + TOLERANCE:
        what = 'logits (export the model with its sigmoid)' if low < 0.0 else 'no probabilities'
        raise LayoutError(f'scores go from {low:.3g} to {high:.3g}, expected 0 to 1: these are {what}, or other columns')


@dataclass(frozen=True)
class Reading:
    """What the columns of a table are.

    Parameters:
        box: first of the four columns of the box.
        score: column of the score, -1 where each column behind the box is the score of a class.
        label: column of the class's number, -1 likewise.
        centred: whether the box is centre and size instead of two corners.
        shares: whether it is in shares of the input's width and height instead of pixels.
        batch: column of the image's number in the batch, -1 for none.
    """

    box: int
    score: int
    label: int
    centred: bool
    shares: bool
    batch: int = -1

    def boxes(self, rows: NDArray, size: tuple[int, int]) -> NDArray[np.float32]:
        """Boxes (n, 4) x1, y1, x2, y2 in pixels of the input.

        Parameters:
            rows (n, k): the table.
            size: height and width of the input in pixels.
        """
        boxes = rows[:, self.box:self.box + 4]
        boxes = corners(boxes[:, :2], boxes[:, 2:]) if self.centred else boxes
        return boxes * np.array([size[1], size[0]] * 2, np.float32) if self.shares else boxes

    def scores(self, rows: NDArray) -> NDArray[np.float32]:
        """Scores (n, 1) or (n, classes) of rows (n, k)."""
        return rows[:, [self.score]] if self.score >= 0 else rows[:, self.box + 4:]

    def fits(self, rows: NDArray, size: tuple[int, int]) -> bool:
        """Whether rows (n, k) can be read so at an input size (height, width)."""
        extent = np.array([size[1], size[0]] * 2, np.float32)
        given = rows[:, self.box:self.box + 4]
        if self.shares != bool(np.all(np.abs(given) <= SHARES)):
            return False
        labels = rows[:, [self.label] if self.label >= 0 else []]    # -1 in rows of score 0, by which tables are filled up
        if np.any(labels % 1.0 != 0.0) or np.any((labels < 0.0) & (self.scores(rows)[:, :1] > 0.0)):
            return False
        if self.batch >= 0 and np.any(rows[:, self.batch] != 0.0):
            return False
        try:
            check_scores(self.scores(rows))
        except LayoutError:
            return False
        boxes = self.boxes(rows, size) / extent
        good = np.all(boxes[:, 2:] - boxes[:, :2] >= -TOLERANCE, axis=1)
        good &= np.all((boxes >= -OUTSIDE) & (boxes <= 1.0 + OUTSIDE), axis=1)
        return bool(np.mean(good) >= 1.0 - GARBAGE)


def readings(columns: int) -> list[Reading]:
    """Readings of a table of so many columns, the most usual first."""
    # Columns of box, score, class and batch.
    orders = {6: [(0, 4, 5, -1), (0, 5, 4, -1), (2, 1, 0, -1), (2, 0, 1, -1)],
              7: [(1, 5, 6, 0), (1, 6, 5, 0), (3, 2, 1, 0), (3, 1, 2, 0)]}
    # Few centres and sizes look like corners, all corners look like centres and sizes.
    forms = [(False, False), (False, True), (True, True), (True, False)]
    labelled = [Reading(box, score, label, *form, batch)
                for form, (box, score, label, batch) in product(forms, orders.get(columns, []))]
    return [*labelled, *(Reading(0, -1, -1, *form) for form in forms)]


class RowReader:
    """Decodes tables of boxes, and learns from each what its columns are.

    Parameters:
        kind: 'end_to_end' for corners in pixels, score and class, 'detr' for centres in shares and a score for each class;
            empty to find out.
    """

    def __init__(self, kind: str = '') -> None:
        fixed = {'end_to_end': [Reading(0, 4, 5, False, False)], 'detr': [Reading(0, -1, -1, True, True)]}
        self._left = fixed.get(kind)

    @property
    def kind(self) -> str:
        """The kind of what has been read, 'end_to_end' for any table with a column of classes."""
        return 'detr' if self._left and self._left[0].label < 0 else 'end_to_end'

    def learn(self, rows: NDArray, size: tuple[int, int]) -> None:
        """Drop the readings that a table contradicts. Raises LayoutError, with what was seen, where none is left.

        Parameters:
            rows (n, k): output for one image; rows of equal values, by which tables are filled up, tell nothing.
            size: height and width of the input in pixels.
        """
        if self._left is None:
            self._left = readings(rows.shape[1])
        finite = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) and not len(finite):
            raise LayoutError(f'no row of the output (1, {rows.shape[0]}, {rows.shape[1]}) is of finite numbers')
        telling = finite[np.ptp(finite, axis=1) > 0.0] if len(finite) else finite
        left = [reading for reading in self._left if reading.fits(telling, size)] if len(telling) else self._left
        if not left:
            ranges = zip(telling.min(axis=0), telling.max(axis=0), strict=True)
            seen = ', '.join(f'{low:.3g} to {high:.3g}' for low, high in list(ranges)[:8])
            raise LayoutError(f'the columns of the output (1, {rows.shape[0]}, {rows.shape[1]}) go from {seen}: expected '
                              'x1, y1, x2, y2 in pixels of the input, score (0 to 1) and class, or cx, cy, w, h in shares of '
                              'it and a score (0 to 1, no logits) for each class')
        self._left = left

    def __call__(self, rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
        """Boxes and probabilities of the classes, of rows above a threshold. Raises LayoutError.

        Parameters:
            rows (n, k): output for one image.
            size: height and width of the input in pixels.
            threshold (0-1): least probability of a box.
        """
        self.learn(rows, size)
        assert self._left is not None
        reading = self._left[0]
        rows = rows[np.isfinite(rows).all(axis=1)]
        rows = rows[reading.scores(rows).max(axis=1, initial=0.0) > threshold]
        scores = reading.scores(rows)
        if reading.label >= 0:
            classes = rows[:, reading.label].astype(np.intp)
            scores = scores * (classes[:, None] == np.arange(classes.max(initial=-1) + 1))
        return reading.boxes(rows, size), scores
