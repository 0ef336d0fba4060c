"""Tight boxes: what stands out from a plain sky in a label.

The labels of the real clips are some 20 pixels wider and higher than what they are around, and drift. A detector that learns
that learns one camera's labels; so training and figures take what stands out, and where nothing is plain the label less
its padding.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# Pixels by which labels are wider and higher than what they are around: medians over 600 objects of the training clips that
# stand before plain sky; it is the same for objects of 5 and of 50 pixels.
PADDING = np.array([20.0, 18.0], np.float32)
PLAIN = 6.0          # of 255, deviation from a plane of colour around a box
FAINT, BOLD = 7.0, 25.0  # least difference from the sky that stands out: a quarter of the largest, between these
SHARE = 0.25
GAP = 5              # pixels between parts of one object: arms and rotors


def standing_out(image: NDArray[np.uint8], box: NDArray) -> tuple[NDArray, NDArray | None]:
    """What is in a box and how far (h, w) each pixel is from the sky's colour there; None where there is no plain sky.

    The sky's colour is a plane over the rim of the box: it brightens towards the horizon.
    """
    height, width = image.shape[:2]
    x1, y1, x2, y2 = np.rint(np.clip(box, 0, [width, height] * 2)).astype(int)
    crop = image[y1:y2, x1:x2]
    around = image[max(y1 - 4, 0):y2 + 4, max(x1 - 4, 0):x2 + 4].astype(np.float32)
    if not crop.size:
        return crop, None
    rim = np.zeros(around.shape[:2], bool)
    rim[:4] = rim[-4:] = rim[:, :4] = rim[:, -4:] = True
    rows, columns = np.mgrid[:around.shape[0], :around.shape[1]] / max(around.shape)
    plane = np.stack([np.ones_like(rows), rows, columns], -1)
    sky, *_ = np.linalg.lstsq(plane[rim], around[rim], rcond=None)
    off = np.abs(around - plane @ sky)
    if off[rim].std(axis=0).max() > PLAIN or off[rim].mean(axis=0).max() > PLAIN:
        return crop, None
    top, left = y1 - max(y1 - 4, 0), x1 - max(x1 - 4, 0)
    return crop, off[top:top + crop.shape[0], left:left + crop.shape[1]].max(axis=2)


def tight_box(image: NDArray[np.uint8], box: NDArray) -> tuple[NDArray[np.float32], bool]:
    """The box of the most outstanding thing in a label, and whether there was one to be seen before plain sky."""
    _, off = standing_out(image, box)
    if off is None or off.max() < FAINT:
        return without_padding(box, PADDING), False
    mask = (off > np.clip(SHARE * off.max(), FAINT, BOLD)).astype(np.uint8)
    _, parts = cv2.connectedComponents(cv2.dilate(mask, np.ones((GAP, GAP), np.uint8)))
    parts[mask == 0] = 0
    rows, columns = np.nonzero(parts == parts.ravel()[np.argmax(off)])
    corner = np.rint(np.clip(box[:2], 0, None))
    found = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]) + np.tile(corner, 2)
    return found.astype(np.float32), True


def tightened(image: NDArray[np.uint8], boxes: NDArray) -> NDArray[np.float32]:
    """Labels (k, 5) of an image with tight boxes."""
    rows = [[row[0], *tight_box(image, row[1:])[0]] for row in boxes]
    return np.array(rows, np.float32).reshape(-1, 5)


def without_padding(boxes: NDArray, padding: NDArray) -> NDArray[np.float32]:
    """Boxes (..., 4) narrower and lower by some pixels about their centres, none below 3 pixels."""
    middle, size = 0.5 * (boxes[..., :2] + boxes[..., 2:]), boxes[..., 2:] - boxes[..., :2]
    half = 0.5 * np.maximum(size - padding, np.minimum(size, 3.0))
    return np.concatenate([middle - half, middle + half], axis=-1).astype(np.float32)


def padded(boxes: NDArray, padding: NDArray = PADDING) -> NDArray[np.float32]:
    """Tight boxes (..., 4) as the labels of the clips are: wider and higher."""
    return np.concatenate([boxes[..., :2] - 0.5 * padding, boxes[..., 2:] + 0.5 * padding], axis=-1).astype(np.float32)
