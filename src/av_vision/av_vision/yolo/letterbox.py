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


class Turn:
    """A turn of an image to the left, about its middle, onto a larger picture that holds all of it.

    Parameters:
        degrees (deg): angle of the turn.
        width, height (pixels): size of the image before.
    """

    def __init__(self, degrees: int, width: int, height: int) -> None:
        across, along = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        self._rotation, self._before = np.array([[across, along], [-along, across]]), np.array([width, height])
        self._after = np.ceil((np.abs(self._rotation) @ self._before).round(6)).astype(int)
        self._on_its_side = round(degrees / 90) % 2 == 1

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture of an image (height, width, 3), grey where it shows nothing of it."""
        shift = 0.5 * (self._after - 1) - self._rotation @ (0.5 * (self._before - 1))    # of middles of pixels
        size, grey = (int(self._after[0]), int(self._after[1])), (LETTERBOX_GREY,) * 3
        return np.asarray(cv2.warpAffine(image, np.column_stack([self._rotation, shift]), size, borderValue=grey), np.uint8)

    def region(self, region: Region) -> Region:
        """The part of the picture that holds a region of the image, at the same scale."""
        low, size = np.array([region.x, region.y]), np.array([region.width, region.height])
        middle = self._rotation @ (low + 0.5 * (size - self._before)) + 0.5 * self._after
        half = 0.5 * np.abs(self._rotation) @ size
        x, y = np.rint(middle - half).clip(0).astype(int).tolist()
        width, height = (np.rint(middle + half).clip(0, self._after).astype(int) - (x, y)).tolist()
        return Region(region.kind, x, y, width, height, round(region.longest * max(width, height) / max(size)), region.least)

    def boxes(self, boxes: NDArray) -> NDArray:
        """Boxes (n, 4; pixels) x1, y1, x2, y2 of the picture in the image, with the sides that they have in the picture."""
        middles, halves = 0.5 * (boxes[:, :2] + boxes[:, 2:]), 0.5 * (boxes[:, 2:] - boxes[:, :2])
        middles = (middles - 0.5 * self._after) @ self._rotation + 0.5 * self._before
        halves = halves[:, ::-1] if self._on_its_side else halves
        return np.concatenate([middles - halves, middles + halves], axis=1).astype(np.float32)


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
