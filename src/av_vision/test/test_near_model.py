"""A second network for near objects, named by the metadata of the first."""

import numpy as np
import pytest
import yolo_models

from av_vision import Detector, DetectorSettings, ModelError

NAMES = "['bird', 'drone', 'kite']"
SIDE = 960


def models(folder, near_names=NAMES, near_model='near.onnx', padding='[0, 0]', truth=yolo_models.TRUTH):
    """A first network that is blind, and a second one that sees `truth` in an image of 320 pixels."""
    yolo_models.write(folder / 'near.onnx', dynamic=True, output=yolo_models.rows_of('v8', 320, 3, truth)[None],
                      metadata={'names': near_names, 'imgsz': '320'})
    cells = len(yolo_models.grid(SIDE))
    return yolo_models.write(folder / 'far.onnx', dynamic=True, output=np.zeros((1, 7, cells)), metadata={
        'names': NAMES, 'imgsz': str(SIDE), 'near_imgsz': '320', 'near_model': near_model, 'padding': padding})


@pytest.mark.parametrize(('padding', 'expected'), [('[0, 0]', (288, 480, 480, 600)), ('[20, 18]', (278, 471, 490, 609))])
def test_large_objects_are_found_by_the_second_network_and_padded_as_by_the_first(tmp_path, padding, expected):
    detector = Detector(models(tmp_path, padding=padding), DetectorSettings(keep=('drone',)))
    found = detector.detect(np.zeros((SIDE, SIDE, 3), np.uint8))
    assert np.rint(found.boxes).tolist() == [list(expected)]


def test_small_objects_are_left_to_the_first(tmp_path):
    small = [(96.0, 160.0, 110.0, 172.0, 1, 0.9)]  # 4 % of the input's side
    detector = Detector(models(tmp_path, truth=small), DetectorSettings(keep=('drone',)))
    assert len(detector.detect(np.zeros((SIDE, SIDE, 3), np.uint8))) == 0


def test_given_class_names_are_those_of_both_networks(tmp_path):
    detector = Detector(models(tmp_path), DetectorSettings(class_names=('gull', 'quadcopter', 'box')))
    assert detector.detect(np.zeros((SIDE, SIDE, 3), np.uint8)).class_names == ('quadcopter', 'gull')


@pytest.mark.parametrize(('changes', 'complaint'), [
    ({'near_model': 'gone.onnx'}, 'gone.onnx'), ({'near_model': '../near.onnx'}, 'expected the name of a file beside it'),
    ({'near_names': "['drone', 'bird', 'kite']"}, 'expected those of')])
def test_a_second_network_that_cannot_be_used_is_named(tmp_path, changes, complaint):
    with pytest.raises(ModelError, match=complaint):
        Detector(models(tmp_path, **changes))
