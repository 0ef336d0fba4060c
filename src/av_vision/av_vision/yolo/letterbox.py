"""Parts of an image, and their conversion to the size and the tensor layout of a model's input.

Tiles are for targets too small for the network (Akyon et al. 2022, arXiv:2202.06934).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

LETTERBOX_GREY = 114  # the grey that YOLO models are trained with
EDGE = 2.0  # pixels from an inner edge of a tile, within which a box counts as cut by it


def letterbox(image: NDArray[np.uint8], height: int, width: int) -> tuple[NDArray[np.uint8], float]:
    """A BGR image (h, w, 3) scaled to the top left of a grey image of height x width, and the scale.

    Results of a YOLO network do not depend on the position of the padding, so that a division maps boxes back.

    Parameters:
        image (h, w, 3): BGR image.
        height, width (pixels): size of the result.
    """
    scale = min(height / image.shape[0], width / image.shape[1])
    if scale != 1.0:
        size = max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1)
        method = cv2.INTER_AREA if scale < 0.5 else cv2.INTER_LINEAR
        image = np.asarray(cv2.resize(image, size, interpolation=method), np.uint8)
    if image.shape[:2] == (height, width):
        return image, scale
    canvas = np.full((height, width, 3), LETTERBOX_GREY, np.uint8)
    canvas[:image.shape[0], :image.shape[1]] = image
    return canvas, scale


def fitting_size(image_height: int, image_width: int, longest: int) -> tuple[int, int]:
    """Height and width, multiples of 32, into which an image fits when its longer side becomes `longest`.

    Parameters:
        image_height, image_width (pixels): size of the image.
        longest (pixels): longer side of the scaled image.
    """
    scale = longest / max(image_height, image_width)
    height, width = (max(math.ceil(round(side * scale) / 32), 1) * 32 for side in (image_height, image_width))
    return height, width


def to_tensor(image: NDArray[np.uint8], rgb: bool, dtype: DTypeLike) -> NDArray:
    """Convert an image to a batch (1, 3, h, w).

    Parameters:
        image (h, w, 3): BGR image.
        rgb: whether the batch is RGB from 0 to 1 instead of BGR from 0 to 255.
        dtype: type of the batch.
    """
    tensor = np.empty((1, 3, *image.shape[:2]), dtype)
    # Plane by plane, in half the time of cv2.dnn.blobFromImages.
    for channel, plane in zip(cv2.split(image)[::-1 if rgb else 1], tensor[0], strict=True):
        np.multiply(channel, np.float32(1.0 / 255.0 if rgb else 1.0), out=plane, casting='unsafe')
    return tensor


class Region(NamedTuple):
    """A part of an image that is searched.

    Parameters:
        kind: full, near, track, bearing or tile.
        x, y (pixels): top-left corner.
        width, height (pixels): its size.
        longest (pixels): its longer side as input of the network.
        least (pixels): larger side of the smallest object that counts; smaller ones are found elsewhere.
    """

    kind: str
    x: int
    y: int
    width: int
    height: int
    longest: int
    least: float = 0.0

    def holds(self, centre: NDArray, size: float) -> bool:
        """Whether an object would have been found here.

        Parameters:
            centre (2,; pixels): its centre.
            size (pixels): its larger side.
        """
        low, high = np.asarray(centre) - 0.5 * size, np.asarray(centre) + 0.5 * size
        return bool(np.all(low >= (self.x, self.y)) and np.all(high <= (self.x + self.width, self.y + self.height))
                    and size >= self.least)


def turned_boxes(boxes: NDArray, quarters: int, width: int, height: int) -> NDArray:
    """Where boxes (n, 4) of an image are in it once `np.rot90` has turned it.

    Parameters:
        boxes (n, 4) (pixels): x1, y1, x2, y2.
        quarters: quarter turns to the left.
        width, height (pixels): size of the image before.
    """
    for _ in range(quarters % 4):
        x1, y1, x2, y2 = boxes.T
        boxes, width, height = np.stack([y1, width - x2, y2, width - x1], axis=1), height, width
    return boxes


def turned_region(region: Region, quarters: int, width: int, height: int) -> Region:
    """A region of an image in the turned image, see `turned_boxes`.

    Parameters:
        region: the part of the image.
        quarters: quarter turns to the left.
        width, height (pixels): size of the image before.
    """
    box = np.array([[region.x, region.y, region.x + region.width, region.y + region.height]])
    x1, y1, x2, y2 = turned_boxes(box, quarters, width, height)[0].tolist()
    return region._replace(x=x1, y=y1, width=x2 - x1, height=y2 - y1)


def tile_corners(width: int, height: int, side: int, overlap: float) -> list[tuple[int, int]]:
    """Top-left corners (x, y) of square tiles that cover an image evenly with at least the share `overlap` in common.

    Parameters:
        width, height (pixels): size of the image.
        side (pixels): side of the tiles.
        overlap (0-1): least common share of neighbouring tiles.
    """
    def starts(length: int) -> list[int]:
        if length <= side:
            return [0]
        count = int(np.ceil((length - side) / (side * (1.0 - overlap)))) + 1
        return np.rint(np.linspace(0, length - side, count)).astype(int).tolist()

    return [(x, y) for y in starts(height) for x in starts(width)]


def whole_in_tile(boxes: NDArray, tile: Region, width: int, height: int) -> NDArray[np.bool_]:
    """Which boxes (n, 4) of an image, found in a tile, do not touch an edge of the tile that lies inside the image.

    A target cut by such an edge is whole in the neighbouring tile or, if it is larger than the overlap, in the whole
    image.

    Parameters:
        boxes (n, 4) (pixels): x1, y1, x2, y2 in the image.
        tile: the part of the image that was searched.
        width, height (pixels): size of the image.
    """
    right, bottom = tile.x + tile.width, tile.y + tile.height
    low = np.array([tile.x if tile.x > 0 else -np.inf, tile.y if tile.y > 0 else -np.inf])
    high = np.array([right if right < width else np.inf, bottom if bottom < height else np.inf])
    return np.all(boxes[:, :2] > low + EDGE, axis=1) & np.all(boxes[:, 2:] < high - EDGE, axis=1)
