"""Tiles cover the image, and what is cut at their edges is left to the neighbour."""

import numpy as np
import pytest
import yolo_models

from av_vision.models import shipped_model
from av_vision.yolo import Detector, DetectorSettings
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


def test_an_image_of_a_tile_needs_none():
    assert tile_corners(416, 300, 416, 0.2) == []


def test_boxes_of_tiles_come_back_at_their_place_and_once(tmp_path):
    path = yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata={'names': "['bird', 'drone', 'kite']"})
    detector = Detector(path, DetectorSettings(slice_size=416, keep=('drone',)))
    found = detector.detect(np.zeros((416, 832, 3), np.uint8))
    # The constant network sees the same drone in the whole image (twice as large) and at its place in each of 3 tiles.
    expected = {(192, 320, 320, 400), (96, 160, 160, 200), (96 + 208, 160, 160 + 208, 200), (96 + 416, 160, 160 + 416, 200)}
    assert {tuple(np.rint(box).astype(int).tolist()) for box in found.boxes} == expected


@pytest.mark.parametrize(('side', 'expected'), [(320, [(1, 3, 320, 640), *3 * [(1, 3, 640, 640)]]),
                                                (800, [(1, 3, 320, 640), *3 * [(1, 3, 800, 800)]])])
def test_tiles_are_enlarged_to_the_models_input_and_never_shrunk(monkeypatch, side, expected):
    detector = Detector(shipped_model(), DetectorSettings(slice_size=side, input_size=640))
    shapes, run = [], detector.model.run
    monkeypatch.setattr(detector.model, 'run', lambda tensor: shapes.append(tensor.shape) or run(tensor))
    detector.detect(np.zeros((side, 2 * side, 3), np.uint8))
    assert shapes == expected
