"""Tiles cover the image, and what is cut at their edges is left to the neighbour."""

import numpy as np
import pytest

from av_vision.yolo.letterbox import Region, tile_corners, whole_in_tile


@pytest.mark.parametrize(('width', 'height'), [(1280, 720), (1920, 1080), (700, 300)])
def test_every_small_target_lies_whole_in_some_tile(width, height):
    corners = tile_corners(width, height, 416, 0.2)
    rng = np.random.default_rng(0)
    centres = rng.uniform([40, 40], [width - 40, height - 40], (500, 2))
    boxes = np.concatenate([centres - 30, centres + 30], 1)
    covered = np.zeros(500, bool)
    for x, y in corners:
        inside = (boxes[:, 0] >= x) & (boxes[:, 1] >= y) & (boxes[:, 2] <= x + 416) & (boxes[:, 3] <= y + 416)
        covered |= inside & whole_in_tile(boxes, Region('tile', x, y, 416, 416, 416), width, height)
    assert covered.all()


def test_an_image_of_a_tile_is_one():
    assert tile_corners(416, 300, 416, 0.2) == [(0, 0)]
