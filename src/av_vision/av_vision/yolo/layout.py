"""The layouts of YOLO exports: recognition, and conversion to boxes.

Sources: YOLOX (Ge et al. 2021, arXiv:2107.08430) and the documented outputs of the YOLOv5, v8 and v10 exports.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Decoded = tuple[NDArray[np.float32], NDArray[np.float32]]  # boxes (n, 4), probabilities (n, classes)


class LayoutError(ValueError):
    """The output is not that of a known YOLO export."""


@dataclass(frozen=True)
class Layout:
    """Format of the input and of the output of an export.

    Parameters:
        name: name of the layout.
        rgb: whether the input is RGB instead of BGR.
        scale: factor from 8-bit values to the input.
        class_count: number of classes from the shape of the output of one image; 0 if it is unknown.
        decode: function from output, input size (height, width) and threshold to boxes and probabilities.
        needs_nms: whether boxes need non-maximum suppression.
    """

    name: str
    rgb: bool
    scale: float
    class_count: Callable[[tuple[int, int]], int]
    decode: Callable[[NDArray, tuple[int, int], float], Decoded]
    needs_nms: bool = True


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


def corners(centre: NDArray, size: NDArray) -> NDArray[np.float32]:
    """Boxes (n, 4) x1, y1, x2, y2 from centres and sizes (n, 2).

    Parameters:
        centre (n, 2): centres.
        size (n, 2): widths and heights.
    """
    return np.concatenate([centre - 0.5 * size, centre + 0.5 * size], axis=1)


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


def decode_end_to_end(rows: NDArray, size: tuple[int, int], threshold: float) -> Decoded:
    """YOLOv10 and 26: x1, y1, x2, y2 in input pixels, score, class; duplicates are already gone.

    Parameters:
        rows (n, 6): output for one image.
        size: height and width of the input in pixels.
        threshold (0-1): least probability of a box.
    """
    rows = rows[rows[:, 4] > threshold]
    classes = rows[:, 5].astype(np.intp)
    return rows[:, :4], rows[:, 4:5] * (classes[:, None] == np.arange(classes.max(initial=-1) + 1))


LAYOUTS = {layout.name: layout for layout in (
    Layout('yolox_raw', False, 1.0, lambda shape: shape[1] - 5, decode_yolox_raw),
    Layout('yolox', False, 1.0, lambda shape: shape[1] - 5, decode_centred),
    Layout('v8', True, 1.0 / 255.0, lambda shape: shape[0] - 4, decode_columns),
    Layout('v5', True, 1.0 / 255.0, lambda shape: shape[1] - 5, decode_centred),
    Layout('end_to_end', True, 1.0 / 255.0, lambda shape: 0, decode_end_to_end, needs_nms=False),
)}


def recognise(output: NDArray, size: tuple[int, int]) -> Layout:
    """The layout of a model from its output (1, a, b) for any image of an input size (height, width).

    The number of rows identifies the family: it is the number of cells (v8, YOLOX), three times this number (v5), or
    neither (end to end). Decoded and undecoded YOLOX differ only in values: decoded centres follow the grid.
    Raises LayoutError with the shape found and those expected.

    Parameters:
        output (1, a, b): output of the model.
        size: height and width of the input in pixels.
    """
    if output.ndim != 3 or output.shape[0] != 1:
        raise LayoutError(f'the output has shape {output.shape}, expected (1, rows, columns) of a YOLO detector')
    _, a, b = output.shape
    counts = cell_counts(size)
    if a in counts and b > 5:
        cells, strides = grid(size, (8, 16, 32) if a == counts[0] else (8, 16, 32, 64))
        decoded = np.median(np.abs(output[0, :, :2] - (cells + 0.5) * strides) / strides) < 4.0
        if not decoded and a != counts[0]:
            raise LayoutError('undecoded YOLOX with a stride of 64 is not known')
        return LAYOUTS['yolox' if decoded else 'yolox_raw']
    if b in counts and a > 4:
        return LAYOUTS['v8']
    if a in [3 * count for count in counts] and b > 5:
        return LAYOUTS['v5']
    if b == 6 and a <= 2000:
        return LAYOUTS['end_to_end']
    raise LayoutError(
        f'the output (1, {a}, {b}) at input {size[0]}x{size[1]} is of no known YOLO export: YOLOX has (1, {counts[0]}, 5+C), '
        f'v8/9/11/12 (1, 4+C, {counts[0]}), v5/v7 (1, {3 * counts[0]}, 5+C), end-to-end (1, N, 6)')
