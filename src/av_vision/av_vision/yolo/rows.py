"""Tables of boxes, one in each row: what the columns may be, and whether the values can be read so.

Exports without cells agree in little: YOLOv10 and 26 give corners in pixels, score and class, RT-DETR (Zhao et al. 2023,
arXiv:2304.08069) centre and size in shares of the input and a score for each class, those of TensorFlow y before x, others an
order of their own.
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
GARBAGE = 0.1           # share of the rows whose boxes may be none: a regression without bounds
LIKELY = 0.25           # score of what is looked for in the mirrored image


class LayoutError(ValueError):
    """The output is not that of a known YOLO export."""


@dataclass(frozen=True)
class Form:
    """How four columns tell a box.

    Parameters:
        order: the columns; y before x, too.
        shares: whether they are in shares of the input's width and height instead of pixels.
    """

    order: str = 'cx cy w h'
    shares: bool = False

    def boxes(self, columns: NDArray, size: tuple[int, int]) -> NDArray[np.float32]:
        """Boxes (n, 4) x1, y1, x2, y2 in pixels of the input, of columns (n, 4).

        Parameters:
            columns (n, 4): in the order of the form.
            size: height and width of the input in pixels.
        """
        columns = columns[:, [1, 0, 3, 2]] if self.order[:2] in ('y1', 'cy') else columns
        low, high = columns[:, :2], columns[:, 2:]
        if self.order[0] == 'c':
            low, high = low - 0.5 * high, low + 0.5 * high
        elif self.order == 'x1 y1 w h':
            high = low + high
        return np.concatenate([low, high], axis=1) * np.array([size[1], size[0]] * 2 if self.shares else 1.0, np.float32)


CORNERS, CENTRE = 'x1 y1 x2 y2', 'cx cy w h'
ORDERS = (CORNERS, CENTRE, 'x1 y1 w h', 'y1 x1 y2 x2', 'cy cx h w')    # the most usual first


def share_of_boxes(boxes: NDArray, size: tuple[int, int]) -> float:
    """Share of boxes (n, 4) x1, y1, x2, y2 that have sides and are in the input (height, width), OUTSIDE beyond at most."""
    boxes = boxes / np.array([size[1], size[0]] * 2)
    good = np.all(boxes[:, 2:] - boxes[:, :2] >= -TOLERANCE, axis=1)
    return float(np.mean(good & np.all((boxes >= -OUTSIDE) & (boxes <= 1.0 + OUTSIDE), axis=1)))


def check_scores(scores: NDArray) -> None:
    """Raise LayoutError where scores of any shape are none: all NaN, or beyond 0 to 1. Single NaN and infinite ones may be."""
    finite = scores[np.isfinite(scores)]
    if scores.size and not finite.size:
        raise LayoutError('no score is a finite number, expected 0 to 1')
    low, high = finite.min(initial=0.0), finite.max(initial=0.0)
    if low < -TOLERANCE or high > 1.0 + TOLERANCE:
        what = 'logits (export the model with its sigmoid)' if low < 0.0 else 'no probabilities'
        raise LayoutError(f'scores go from {low:.3g} to {high:.3g}, expected 0 to 1: these are {what}, or other columns')


def telling(rows: NDArray) -> NDArray:
    """The rows (n, k) of finite numbers, without those of equal values, by which tables are filled up.

    Raises LayoutError where no row is finite.
    """
    finite = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) and not len(finite):
        raise LayoutError(f'no row of the output (1, {rows.shape[0]}, {rows.shape[1]}) is of finite numbers')
    return finite[np.ptp(finite, axis=1) > 0.0]


@dataclass(frozen=True)
class Reading:
    """What the columns of a table are.

    Parameters:
        form: what the four columns of the box are.
        box: first of them.
        score: column of the score, -1 where each column behind the box is the score of a class.
        label: column of the class's number, -1 likewise.
        batch: column of the image's number in the batch, -1 for none.
        classes: number of classes where the model names them, else 0.
        objectness: whether the score of any object is behind the box, by which those of the classes are multiplied.
    """

    form: Form
    box: int = 0
    score: int = -1
    label: int = -1
    batch: int = -1
    classes: int = 0
    objectness: bool = False

    def __str__(self) -> str:
        return (f'{self.form.order} in {"shares" if self.form.shares else "pixels"} of the input from column {self.box}, '
                + (f'score in {self.score}, class in {self.label}' if self.label >= 0 else 'then a score for each class'))

    def boxes(self, rows: NDArray, size: tuple[int, int]) -> NDArray[np.float32]:
        """Boxes (n, 4) x1, y1, x2, y2 in pixels of the input (height, width), of rows (n, k)."""
        return self.form.boxes(rows[:, self.box:self.box + 4], size)

    def scores(self, rows: NDArray) -> NDArray[np.float32]:
        """Scores (n, 1) or (n, classes) of rows (n, k)."""
        if self.objectness:
            return rows[:, self.box + 5:] * rows[:, self.box + 4:self.box + 5]
        return rows[:, [self.score]] if self.score >= 0 else rows[:, self.box + 4:]

    def likely(self, rows: NDArray, least: float = LIKELY) -> NDArray:
        """The rows (n, k) whose score is above `least`."""
        return rows[self.scores(rows).max(axis=1, initial=0.0) > least]

    def decode(self, rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
        """Boxes and probabilities of the classes, of the rows above a threshold that are `telling`. Raises LayoutError.

        Parameters:
            rows (n, k): output for one image.
            size: height and width of the input in pixels.
            threshold (0-1): least probability of a box.
        """
        rows = telling(rows)
        scores = self.scores(rows)
        check_scores(scores)
        passed = scores.max(axis=1, initial=0.0) > threshold
        rows, scores = rows[passed], scores[passed]
        if self.label >= 0:
            classes = rows[:, self.label].astype(np.intp)
            scores = scores * (classes[:, None] == np.arange(classes.max(initial=-1) + 1))
        return self.boxes(rows, size), scores

    def fits(self, rows: NDArray, size: tuple[int, int]) -> bool:
        """Whether rows (n, k) can be read so at an input size (height, width)."""
        if self.form.shares != bool(np.all(np.abs(rows[:, self.box:self.box + 4]) <= SHARES)):
            return False
        labels = rows[:, [self.label] if self.label >= 0 else []]    # -1 in rows of score 0, by which tables are filled up
        if np.any(labels % 1.0 != 0.0) or np.any(labels[self.scores(rows)[:, 0] > 0.0] < 0.0):
            return False
        if self.classes and np.any(labels >= self.classes):
            return False
        if self.batch >= 0 and np.any(rows[:, self.batch] != 0.0):
            return False
        try:
            check_scores(self.scores(rows))
        except LayoutError:
            return False
        return all(share_of_boxes(self.boxes(some, size), size) >= 1.0 - GARBAGE for some in (rows, self.likely(rows))
                   if len(some))

    def mirrored(self, rows: NDArray, other: NDArray, size: tuple[int, int]) -> float:
        """Overlap of the likeliest box of rows (n, k) with that of the mirrored image, whose rows are `other` (m, k)."""
        best = rows[[self.scores(rows).max(axis=1).argmax()]]
        x1, y1, x2, y2 = self.boxes(best, size)[0]
        seen = self.boxes(self.likely(other, 0.5 * float(self.scores(best).max())), size)
        low, high = np.maximum(seen[:, :2], [size[1] - x2, y1]), np.minimum(seen[:, 2:], [size[1] - x1, y2])
        common = np.clip(high - low, 0.0, None).prod(axis=1)
        area = (seen[:, 2:] - seen[:, :2]).prod(axis=1) + (x2 - x1) * (y2 - y1)
        return float(np.max(common / np.maximum(area - common, 1e-6), initial=0.0))


def readings(columns: int, classes: int = 0) -> list[Reading]:
    """Readings of a table of so many columns, the most usual first.

    Parameters:
        columns: number of columns.
        classes: number of classes where the model names them, else 0.
    """
    # Columns of box, score, class and batch.
    places = {6: [(0, 4, 5, -1), (0, 5, 4, -1), (2, 1, 0, -1), (2, 0, 1, -1), (1, 0, 5, -1), (1, 5, 0, -1)],
              7: [(1, 5, 6, 0), (1, 6, 5, 0), (3, 2, 1, 0), (3, 1, 2, 0)]}.get(columns, [])
    found = []
    for order in ORDERS:
        forms = [Form(order, shares) for shares in ((True, False) if order == CENTRE else (False, True))]
        labelled = [Reading(form, *place, classes) for form, place in product(forms, places)]
        by_class = [Reading(form) for form in forms] if classes in (0, columns - 4) else []
        # DETR's centres in shares have a score for each class, other tables of centres rather a column of the class.
        found += [*by_class[:1], *labelled, *by_class[1:]] if order == CENTRE else [*labelled, *by_class]
    return found
