"""Detectors by name."""

from __future__ import annotations

import numpy as np
import pytest

from av_common.parameters import node_parameters
from av_vision import DetectorSettings, ForeignDetector, ModelError, make_detector


def named(name):
    return make_detector(node_parameters('av_vision', 'detector_node', overrides={'model': name}))


@pytest.mark.parametrize('name', ['.', 'x' * 4000, 'a\0b', '/', 'missing/model', 'unknown'])
def test_what_names_neither_a_file_nor_a_detector_is_refused_with_those_installed(name, tmp_path, monkeypatch):
    """Whatever the file system says to it: folders, names that no file can have."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match='^model .*, expected an ONNX file or one of shipped'):
        named(name)


def test_a_file_is_told_by_its_suffix_or_by_being_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'weights').touch()
    (tmp_path / 'shipped').touch()
    for name, reason in (('weights', 'weights is empty'), ('missing.onnx', 'missing.onnx does not exist')):
        with pytest.raises(ModelError, match=reason):
            named(name)
    assert named('shipped').model.path.name == named('').model.path.name == 'drone_detector.onnx'


@pytest.mark.parametrize('box', [[300.0, 200.0, 40.0, 30.0], [0.4, 0.4, 0.5, 0.5], [700.0, 10.0, 730.0, 30.0],
                                 [30.0, 90.0, 60.0, 90.0]])
def test_boxes_in_another_order_or_unit_are_refused(box):
    """Corner and size, shares of the image, pixels of a larger one, a line."""
    good = [300.0, 200.0, 340.0, 230.0]
    image, answer = np.zeros((480, 640, 3), np.uint8), [good]
    detector = ForeignDetector(lambda image: (answer, [0.9] * len(answer)), DetectorSettings(), 'drone')
    assert detector.candidates(image, 0.1).boxes.tolist() == [good]
    answer.append(box)
    assert detector.candidates(image, 0.1).boxes.tolist() == [good]
    del answer[0]
    with pytest.raises(ValueError, match='image of 640 x 480, expected x1, y1, x2, y2 in pixels'):
        detector.candidates(image, 0.1)
