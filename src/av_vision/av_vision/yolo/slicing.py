"""Tiles of an image, for targets too small for the network (Akyon et al. 2022, arXiv:2202.06934)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from av_vision.yolo.region import Region

EDGE = 2.0  # pixels


def tile_corners(width: int, height: int, side: int, overlap: float) -> list[tuple[int, int]]:
    """Top-left corners (x, y) of square tiles that cover an image evenly with at least the share `overlap` in common.

    An image no larger than a tile needs none: the list is empty.

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

    if width <= side and height <= side:
        return []
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
