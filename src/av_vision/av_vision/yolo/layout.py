"""The layouts of YOLO exports: recognition, and conversion to boxes.

Sources: YOLOX (Ge et al. 2021, arXiv:2107.08430) and the documented outputs of the YOLOv5, v8 and v10 exports. Tables of boxes,
of which there are more kinds, are read by `rows.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

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
    RowReader,
    check_scores,
    share_of_boxes,
)

MOST_ROWS = 2000    # of a table of boxes
TABLE_COLUMNS = (6, 7)    # of tables with a class in each row, which may be empty or of zeros at first
MOST_STRIDES = 4.0  # from the middles of decoded boxes to their cells, in the median
CENTRED = Form()
Decode = Callable[..., Decoded]


@dataclass(frozen=True)
class Layout:
    """Format of the input and of the output of an export.

    Parameters:
        name: name of the layout.
        rgb: whether the input is RGB instead of BGR.
        scale: factor from 8-bit values to the input.
        class_count: number of classes from the shape of the output of one image; 0 if it is unknown.
        decode: function from output, input size (height, width) and threshold to boxes and probabilities. It may raise
            LayoutError.
    """

    name: str
    rgb: bool
    scale: float
    class_count: Callable[[tuple[int, int]], int]
    decode: Decode


@lru_cache(maxsize=16)
def grid(size: tuple[int, int], strides: tuple[int, ...] = (8, 16, 32),
         anchors: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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


def cell_counts(size: tuple[int, int]) -> tuple[int, int]:
    """Numbers of cells with strides 8, 16, 32 and, for the larger variants, 8 to 64."""
    count = [(size[0] // stride) * (size[1] // stride) for stride in (8, 16, 32, 64)]
    return sum(count[:3]), sum(count)


def decode_centred(rows: NDArray, size: tuple[int, int], threshold: float, form: Form = CENTRED) -> Decoded:
    """YOLOv5, YOLOv7 and decoded YOLOX: cx, cy, w, h in input pixels, objectness, classes.

    Parameters:
        rows (n, 5+C): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
        form: another form of the box.
    """
    check_scores(rows[:, 4])
    rows = rows[rows[:, 4] > threshold]  # a class probability is at most 1: cheap and exact
    probabilities = rows[:, 5:] * rows[:, 4:5]
    passed = probabilities.max(axis=1, initial=0.0) > threshold
    return form.boxes(rows[passed, :4], size), probabilities[passed]


def decode_yolox_raw(rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
    """YOLOX as trained: offsets from the cell in cells, logarithms of the size in cells, objectness, classes.

    Parameters:
        rows (n, 5+C): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
    """
    check_scores(rows[:, 4])
    cells, strides = grid(size)
    passed = rows[:, 4] > threshold
    rows, cells, strides = rows[passed], cells[passed], strides[passed]
    rows = np.concatenate([(rows[:, :2] + cells) * strides, np.exp(rows[:, 2:4]) * strides, rows[:, 4:]], axis=1)
    return decode_centred(rows, size, threshold)


def decode_columns(columns: NDArray, size: tuple[int, int], threshold: float, form: Form = CENTRED) -> Decoded:
    """YOLOv8, 9, 11, 12: (4+C, n), cx, cy, w, h in input pixels and one probability for each class.

    Parameters:
        columns (4+C, n): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
        form: another form of the box.
    """
    best = columns[4:].max(axis=0)
    check_scores(best)
    rows = columns[:, np.flatnonzero(best > threshold)].T
    return form.boxes(rows[:, :4], size), rows[:, 4:]


def decode_columns_turned(rows: NDArray, size: tuple[int, int], threshold: float, form: Form = CENTRED) -> Decoded:
    """The same with rows and columns exchanged, (n, 4+C); parameters as for `decode_columns`."""
    return decode_columns(rows.T, size, threshold, form)


LAYOUTS = {layout.name: layout for layout in (
    Layout('yolox_raw', False, 1.0, lambda shape: shape[1] - 5, decode_yolox_raw),
    Layout('yolox', False, 1.0, lambda shape: shape[1] - 5, decode_centred),
    Layout('v8', True, 1.0 / 255.0, lambda shape: shape[0] - 4, decode_columns),
    Layout('v5', True, 1.0 / 255.0, lambda shape: shape[1] - 5, decode_centred),
    Layout('end_to_end', True, 1.0 / 255.0, lambda shape: 0, RowReader('end_to_end')),
    Layout('detr', True, 1.0 / 255.0, lambda shape: shape[1] - 4, RowReader('detr')),
)}


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
    counts = cell_counts(size)
    if a in counts and classes and b == 4 + classes:
        turned = replace(LAYOUTS['v8'], class_count=lambda shape: shape[1] - 4, decode=decode_columns_turned)
        return _of_cells(turned, output[0, :, :4], output[0, :, 4:], size)[0]
    if a in counts and b > 5:
        layout, strides = _of_cells(LAYOUTS['yolox'], output[0, :, :4], output[0, :, 4:], size)
        if strides >= MOST_STRIDES and a != counts[0]:
            raise LayoutError('undecoded YOLOX with a stride of 64 is not known')
        return layout if strides < MOST_STRIDES else LAYOUTS['yolox_raw']
    if b in counts and a > 4:
        return _of_cells(LAYOUTS['v8'], output[0, :4].T, output[0, 4:], size)[0]
    if a in [3 * count for count in counts] and b > 5:
        return _of_cells(LAYOUTS['v5'], output[0, :, :4], output[0, :, 4:], size)[0]
    if b >= 5 and a <= MOST_ROWS and (b in TABLE_COLUMNS or output.any()):
        reader = RowReader(classes=classes)
        reader.learn(output[0], size)
        return replace(LAYOUTS[reader.kind], decode=reader)
    raise LayoutError(
        f'the output (1, {a}, {b}) at input {size[0]}x{size[1]} is of no known YOLO export: YOLOX has (1, {counts[0]}, 5+C), '
        f'v8/9/11/12 (1, 4+C, {counts[0]}), v5/v7 (1, {3 * counts[0]}, 5+C), end-to-end (1, N, 6), RT-DETR (1, N, 4+C)')


def _of_cells(layout: Layout, boxes: NDArray, scores: NDArray, size: tuple[int, int]) -> tuple[Layout, float]:
    """A layout with the form of its boxes, and how many strides these are from their cells. Raises LayoutError for the scores.

    Boxes whose second corner is right of and below the first in nearly all cells are corners: centre and size are so only
    close to the origin. Their middles follow the cells in x and y, or in y and x.

    Parameters:
        layout: layout of cells.
        boxes (n, 4), scores: output for one image, by cell.
        size: height and width of the input in pixels.
    """
    check_scores(scores)
    finite = np.isfinite(boxes).all(axis=1)
    boxes, shares = boxes[finite], bool(np.max(boxes[finite], initial=0.0) <= SHARES)
    telling = np.unique(boxes[np.ptp(boxes, axis=1) > 0.0], axis=0) if len(boxes) else boxes
    corners = len(telling) and share_of_boxes(Form(CORNERS, shares).boxes(telling, size), size) >= 1.0 - GARBAGE
    forms = [Form(order, shares) for order in ((CORNERS, 'y1 x1 y2 x2') if corners else (CENTRE, 'cy cx h w'))]
    counts = cell_counts(size)
    anchors = 1 if len(finite) in counts else 3
    cells, strides = grid(size, (8, 16, 32) if len(finite) == anchors * counts[0] else (8, 16, 32, 64), anchors)
    distances = []
    for form in forms:
        found = form.boxes(boxes, size)
        middles = 0.5 * (found[:, :2] + found[:, 2:])
        away = np.abs(middles / strides[finite] - cells[finite] - 0.5)
        distances.append(float(np.median(away)) if len(away) else np.inf)
    best = int(distances[1] < min(distances[0], MOST_STRIDES))
    return replace(layout, decode=partial(layout.decode, form=forms[best])), distances[best]
