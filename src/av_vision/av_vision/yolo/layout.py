"""The layouts of YOLO exports: recognition, and conversion to boxes.

Sources: YOLOX (Ge et al. 2021, arXiv:2107.08430) and the documented outputs of the YOLOv5, v8 and v10 exports. Tables of boxes,
of which there are more kinds, are read by `rows.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from av_vision.yolo.rows import SHARES, Decoded, LayoutError, RowReader, check_scores, corners

MOST_ROWS = 2000    # of a table of boxes
Decode = Callable[[NDArray, tuple[int, int], float], Decoded]


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
def grid(size: tuple[int, int], strides: tuple[int, ...] = (8, 16, 32)) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Cell corners (n, 2) in cells and strides (n, 1) of all cells of an input (height, width), row by row, fine to coarse.

    Parameters:
        size: height and width of the input in pixels.
        strides (pixels): sizes of the cells.
    """
    cells, steps = [], []
    for stride in strides:
        y, x = np.mgrid[:size[0] // stride, :size[1] // stride]
        cells.append(np.stack([x, y], -1).reshape(-1, 2))
        steps.append(np.full((y.size, 1), stride))
    return np.concatenate(cells).astype(np.float32), np.concatenate(steps).astype(np.float32)


def cell_counts(size: tuple[int, int]) -> tuple[int, int]:
    """Numbers of cells with strides 8, 16, 32 and, for the larger variants, 8 to 64."""
    count = [(size[0] // stride) * (size[1] // stride) for stride in (8, 16, 32, 64)]
    return sum(count[:3]), sum(count)


def decode_centred(rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
    """YOLOv5, YOLOv7 and decoded YOLOX: cx, cy, w, h in input pixels, objectness, classes.

    Parameters:
        rows (n, 5+C): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
    """
    rows = rows[rows[:, 4] > threshold]  # a class probability is at most 1: cheap and exact
    probabilities = rows[:, 5:] * rows[:, 4:5]
    passed = probabilities.max(axis=1, initial=0.0) > threshold
    return corners(rows[passed, :2], rows[passed, 2:4]), probabilities[passed]


def decode_yolox_raw(rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
    """YOLOX as trained: offsets from the cell in cells, logarithms of the size in cells, objectness, classes.

    Parameters:
        rows (n, 5+C): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
    """
    cells, strides = grid(size)
    passed = rows[:, 4] > threshold
    rows, cells, strides = rows[passed], cells[passed], strides[passed]
    rows = np.concatenate([(rows[:, :2] + cells) * strides, np.exp(rows[:, 2:4]) * strides, rows[:, 4:]], axis=1)
    return decode_centred(rows, size, threshold)


def decode_columns(columns: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
    """YOLOv8, 9, 11, 12: (4+C, n), cx, cy, w, h in input pixels and one probability for each class.

    Parameters:
        columns (4+C, n): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
    """
    rows = columns[:, np.flatnonzero(columns[4:].max(axis=0) > threshold)].T
    return corners(rows[:, :2], rows[:, 2:4]), rows[:, 4:]


def decode_columns_turned(rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
    """The same with rows and columns exchanged, (n, 4+C); parameters as for `decode_columns`."""
    return decode_columns(rows.T, size, threshold)


def in_shares(decode: Decode) -> Decode:
    """A function that decodes boxes in shares of the input's width and height."""
    def decoded(output: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
        boxes, probabilities = decode(output, size, threshold)
        return boxes * np.array([size[1], size[0]] * 2, np.float32), probabilities
    return decoded


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
        return _in_pixels(replace(LAYOUTS['v8'], class_count=lambda shape: shape[1] - 4, decode=decode_columns_turned),
                          output[0, :, :4], output[0, :, 4:])
    if a in counts and b > 5:
        cells, strides = grid(size, (8, 16, 32) if a == counts[0] else (8, 16, 32, 64))
        decoded = np.median(np.abs(output[0, :, :2] - (cells + 0.5) * strides) / strides) < 4.0
        if not decoded and a != counts[0]:
            raise LayoutError('undecoded YOLOX with a stride of 64 is not known')
        check_scores(output[0, :, 4:])
        return LAYOUTS['yolox' if decoded else 'yolox_raw']
    if b in counts and a > 4:
        return _in_pixels(LAYOUTS['v8'], output[0, :4].T, output[0, 4:])
    if a in [3 * count for count in counts] and b > 5:
        return _in_pixels(LAYOUTS['v5'], output[0, :, :4], output[0, :, 4:])
    if b >= 5 and a <= MOST_ROWS and (b == 6 or output.any()):
        reader = RowReader()
        reader.learn(output[0], size)
        return replace(LAYOUTS[reader.kind], decode=reader)
    raise LayoutError(
        f'the output (1, {a}, {b}) at input {size[0]}x{size[1]} is of no known YOLO export: YOLOX has (1, {counts[0]}, 5+C), '
        f'v8/9/11/12 (1, 4+C, {counts[0]}), v5/v7 (1, {3 * counts[0]}, 5+C), end-to-end (1, N, 6), RT-DETR (1, N, 4+C)')


def _in_pixels(layout: Layout, boxes: NDArray, scores: NDArray) -> Layout:
    """A layout, or that of boxes in shares of the input, which all fit into two pixels. Raises LayoutError for the scores."""
    check_scores(scores)
    return replace(layout, decode=in_shares(layout.decode)) if np.nanmax(boxes, initial=0.0) <= SHARES else layout
