"""The layouts of YOLO exports: recognition, and conversion to boxes.

Sources: YOLOX (Ge et al. 2021, arXiv:2107.08430) and the documented outputs of the YOLOv5, v8 and v10 exports. All of them are
rows, each of a box; what their columns are is a `Reading`. One that a table of boxes contradicts is dropped. Where several are
left and something is seen, the mirrored image tells: what is at x is then at width - x. Of those that are left after that the
most usual counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from av_vision.yolo.rows import (
    CENTRE,
    CORNERS,
    GARBAGE,
    SHARES,
    Decoded,
    Form,
    LayoutError,
    Reading,
    check_scores,
    readings,
    share_of_boxes,
    telling,
)

MOST_ROWS = 2000    # of a table of boxes
TABLE_COLUMNS = (6, 7)    # of tables with a class in each row, which may be empty or of zeros at first
SAME, OTHER = 0.5, 0.3  # overlap of a box with its mirror image, and by how much less it is in a reading that is wrong
MOST_MIRRORED = 20      # images
MOST_STRIDES = 4.0  # from the middles of decoded boxes to their cells, in the median
CELL_ORDERS = (CENTRE, CORNERS, 'cy cx h w', 'y1 x1 y2 x2')    # the most usual first
STRIDES = (8, 16, 32, 64)    # pixels, of the larger variants; of the others without the last


@dataclass
class Layout:
    """Format of the input of an export, and what the rows of its output are: of tables of boxes each output may tell more.

    Parameters:
        readings: of its rows that fit all outputs so far, the most usual first.
        classes: number of classes; 0 if it is unknown.
        rgb: whether the input is RGB from 0 to 1 instead of BGR from 0 to 255.
        turned: whether rows of boxes are columns of the output.
        in_cells: whether boxes are offsets and logarithms of sizes in cells, as YOLOX is trained.
        is_table: whether its rows are of no cells, so that values alone tell how they are read.
    """

    readings: list[Reading]
    classes: int = 0
    rgb: bool = True
    turned: bool = False
    in_cells: bool = False
    is_table: bool = False
    _to_mirror: int = MOST_MIRRORED
    _overlaps: dict[Reading, float] = field(default_factory=dict)

    @property
    def columns(self) -> str:
        """What the columns of a table are taken for; empty for layouts of cells."""
        return f'{self.readings[0]}{", assumed, as other orders fit" if self._several else ""}' if self.is_table else ''

    @property
    def _several(self) -> bool:
        return len({reading.form for reading in self.readings}) > 1

    def learn(self, rows: NDArray, size: tuple[int, int]) -> None:
        """Drop the readings that a table contradicts. Raises LayoutError, with what was seen, where none is left.

        Parameters:
            rows (n, k): output for one image.
            size: height and width of the input in pixels.
        """
        seen = np.unique(telling(rows), axis=0)
        left = [reading for reading in self.readings if reading.fits(seen, size)] if len(seen) else self.readings
        if not left:
            ranges = zip(seen.min(axis=0), seen.max(axis=0), strict=True)
            text = ', '.join(f'{low:.3g} to {high:.3g}' for low, high in list(ranges)[:8])
            raise LayoutError(f'the columns of the output (1, {rows.shape[0]}, {rows.shape[1]}) go from {text}: expected '
                              'x1, y1, x2, y2 in pixels of the input, score (0 to 1) and class, or cx, cy, w, h in shares of '
                              'it and a score (0 to 1, no logits) for each class')
        # A score that is 0 in each row says nothing, and is rather another column.
        self.readings = sorted(left, key=lambda reading: len(seen) > 0 and not reading.scores(seen).any())

    def settle(self, rows: NDArray, size: tuple[int, int], shown: tuple[float, float], mirrored: Callable[[], NDArray]) -> None:
        """Learn from a table, and from that of the mirrored image where something is seen and several readings are left.

        Parameters:
            rows (n, k): output for one image.
            size: height and width of the input in pixels.
            shown: height and width of the image in the input; no object is beyond it.
            mirrored: function that gives the output (n, k) for the same image with left and right exchanged.
        """
        if self.is_table:
            self.learn(rows, size)
            if self._several and self._to_mirror and any(len(reading.likely(rows)) for reading in self.readings):
                self._compare(telling(rows), telling(mirrored()), size, shown)

    def _compare(self, rows: NDArray, mirrored: NDArray, size: tuple[int, int], shown: tuple[float, float]) -> None:
        """Drop the readings in which less than in others is where it must be, over all images so far."""
        self._to_mirror -= 1
        for reading in self.readings:
            # A network of constants is not told apart by what it answers to the mirrored image.
            overlap = 0.0 if np.array_equal(rows, mirrored) else reading.mirrored(rows, mirrored, size)
            boxes = reading.boxes(reading.likely(rows), size)
            beyond = np.any(0.5 * (boxes[:, :2] + boxes[:, 2:]) > [shown[1], shown[0]], axis=1)
            self._overlaps[reading] = self._overlaps.get(reading, 0.0) + overlap - float(beyond.mean() if len(boxes) else 0.0)
        best = max(self._overlaps[reading] for reading in self.readings)    # of those that no table has contradicted
        if best >= SAME or best == 0.0:
            self.readings = [reading for reading in self.readings if self._overlaps[reading] >= best - OTHER]

    def decode(self, output: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
        """Boxes in pixels of the input, and probabilities of the classes. Raises LayoutError for scores that are none.

        Parameters:
            output (a, b): output for one image.
            size: height and width of the input in pixels.
            threshold (0-1): least probability of a box.
        """
        rows = output.T if self.turned else output
        if self.in_cells:
            cells, strides = grid(size, STRIDES[:3])
            with np.errstate(over='ignore'):    # infinite boxes are left out
                rows = np.concatenate([(rows[:, :2] + cells) * strides, np.exp(rows[:, 2:4]) * strides, rows[:, 4:]], axis=1)
        return self.readings[0].decode(rows, size, threshold)


@lru_cache(maxsize=16)
def grid(size: tuple[int, int], strides: tuple[int, ...], anchors: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Cell corners (n, 2) in cells and strides (n, 1) of all cells of an input (height, width), row by row, fine to coarse.

    Parameters:
        size: height and width of the input in pixels.
        strides (pixels): sizes of the cells.
        anchors: how often the cells of a stride follow one another.
    """
    cells, steps = [], []
    for stride in strides:
        y, x = np.mgrid[:size[0] // stride, :size[1] // stride]
        cells += [np.stack([x, y], -1).reshape(-1, 2)] * anchors
        steps.append(np.full((anchors * y.size, 1), stride))
    return np.concatenate(cells).astype(np.float32), np.concatenate(steps).astype(np.float32)


def joined(outputs: Sequence[NDArray]) -> tuple[NDArray[np.float32], int]:
    """One output (1, a, b) for an image, and how many classes it has where that is certain, else 0.

    Boxes (1, n, 4) are joined with the outputs that have one or more values for each of them; else the first output counts.
    Exports with suppression of their own give one table (n, columns) for one image.
    """
    boxes = next((one for one in outputs if one.ndim == 3 and one.shape[2] == 4), np.empty(()))
    others = [one if one.ndim == 3 else one[..., np.newaxis] for one in outputs if one is not boxes and 2 <= one.ndim <= 3
              and one.shape[:2] == boxes.shape[:2]]
    if others:
        return np.concatenate([boxes, *others], axis=2, dtype=np.float32), others[0].shape[2] if len(others) == 1 else 0
    first = outputs[0]
    return np.asarray(first[None] if first.ndim == 2 and first.shape[1] in TABLE_COLUMNS else first, np.float32), 0


def recognise(output: NDArray, size: tuple[int, int], classes: int = 0) -> Layout:
    """The layout of a model from its output (1, a, b) for any image of an input size (height, width).

    The number of rows identifies the family: it is the number of cells (v8, YOLOX), three times this number (v5), or
    neither (a table of boxes). Decoded and undecoded YOLOX differ only in values: decoded centres follow the grid.
    Raises LayoutError with the shape or the values found and those expected.

    Parameters:
        output (1, a, b): output of the model.
        size: height and width of the input in pixels.
        classes: number of classes where the model names them, else 0.
    """
    if output.ndim != 3 or output.shape[0] != 1:
        raise LayoutError(f'the output has shape {output.shape}, expected (1, rows, columns) of a YOLO detector')
    _, a, b = output.shape
    all_cells = [grid(size, STRIDES[:count], anchors) for anchors in (1, 3) for count in (3, 4)]
    counts = [len(cells) for cells, _ in all_cells]
    turned = b in counts[:2] and a > 4 and a not in counts[:2]
    rows = output[0].T if turned else output[0]
    count, columns = rows.shape
    by_class = turned or (count in counts[:2] and bool(classes) and columns == 4 + classes)
    if by_class or (count in counts and columns > 5):
        objectness = not by_class
        form, strides = form_of_cells(rows, size, *all_cells[counts.index(count)])
        is_yolox, decoded = objectness and count in counts[:2], strides < MOST_STRIDES
        if is_yolox and not decoded and count != counts[0]:
            raise LayoutError('undecoded YOLOX with a stride of 64 is not known')
        in_cells = is_yolox and not decoded
        reading = Reading(Form() if in_cells else form, objectness=objectness)
        return Layout([reading], columns - 4 - objectness, not is_yolox, turned, in_cells)
    if b >= 5 and a <= MOST_ROWS and (b in TABLE_COLUMNS or output.any()):
        layout = Layout(readings(b, classes), is_table=True)
        layout.learn(rows, size)
        layout.classes = 0 if layout.readings[0].label >= 0 else b - 4    # a column of classes does not tell how many there are
        return layout
    raise LayoutError(
        f'the output (1, {a}, {b}) at input {size[0]}x{size[1]} is of no known YOLO export: YOLOX has (1, {counts[0]}, 5+C), '
        f'v8/9/11/12 (1, 4+C, {counts[0]}), v5/v7 (1, {counts[2]}, 5+C), end-to-end (1, N, 6), RT-DETR (1, N, 4+C)')


def form_of_cells(rows: NDArray, size: tuple[int, int], cells: NDArray, strides: NDArray) -> tuple[Form, float]:
    """The form of the boxes of rows (n, 4+k) by cell, and how many strides these are from their cells.

    Their middles follow the cells: read in another form than theirs they are ten times as far away or more, unless they are
    small. But where nearly all are boxes as corners, they are corners: centre and size are so only close to the origin. Where
    no form is near, the cells are in another order than the grid, and the most usual form counts.

    Parameters:
        rows (n, 4+k): output for one image, boxes and scores.
        size: height and width of the input in pixels.
        cells (n, 2), strides (n, 1): see `grid`.

    Raises LayoutError for scores that are none.
    """
    check_scores(rows[:, 4:])
    finite = np.isfinite(rows[:, :4]).all(axis=1)
    boxes, cells, strides = rows[finite, :4], cells[finite], strides[finite]
    shares = bool(np.max(boxes, initial=0.0) <= SHARES)
    some = np.unique(boxes[np.ptp(boxes, axis=1) > 0.0], axis=0) if len(boxes) else boxes
    forms = [Form(order, shares) for order in CELL_ORDERS]
    corners = [form for form in forms if form.order[0] in 'xy' and len(some)
               and share_of_boxes(form.boxes(some, size), size) >= 1.0 - GARBAGE]
    distances = {}
    for form in corners or forms:
        found = form.boxes(boxes, size)
        away = np.abs(0.5 * (found[:, :2] + found[:, 2:]) / strides - cells - 0.5)
        distances[form] = float(np.median(away)) if len(away) else np.inf
    nearest = min(distances, key=lambda form: distances[form])
    best = nearest if distances[nearest] < MOST_STRIDES else next(iter(distances))
    return best, distances[best]
