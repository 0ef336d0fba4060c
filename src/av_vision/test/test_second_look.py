"""A second look at small candidates: windows around them, and what two networks say together."""

import numpy as np
import pytest
import yolo_models
from scipy.special import expit
from scipy.special import logit as log_odds

from av_vision.yolo import Detector, DetectorSettings, ModelError
from av_vision.yolo.second_look import SIDE, SecondLook, windows

NAMES = "['bird', 'drone', 'kite']"
INPUT = 960
BOX = (500.0, 300.0, 520.0, 312.0)  # 2 % of the image
MIDDLE = (55.0, 55.0, 73.0, 73.0)  # too small for the near pass
GAIN, WEIGHT, SHIFT = 0.8, 0.5, 0.3


def detector(folder, score, seen, second_look=f'[{GAIN}, {WEIGHT}, {SHIFT}]', box=BOX, threshold=0.02):
    """A detector whose first network sees a drone of a score, and whose second one sees `seen` in each window."""
    yolo_models.write(folder / 'near.onnx', dynamic=True, output=yolo_models.rows_of('v8', 320, 3, seen)[None],
                      metadata={'names': NAMES, 'imgsz': '320'})
    first = yolo_models.rows_of('v8', INPUT, 3, [(*box, 1, score)])[None]
    metadata = {'names': NAMES, 'imgsz': str(INPUT), 'near_imgsz': '320', 'near_model': 'near.onnx'}
    metadata |= {'second_look': second_look} if second_look else {}
    path = yolo_models.write(folder / 'far.onnx', dynamic=True, output=first, metadata=metadata)
    return Detector(path, DetectorSettings(keep=('drone',), score_threshold=threshold))


def image():
    return np.zeros((INPUT, INPUT, 3), np.uint8)


@pytest.mark.parametrize(('first', 'second'), [(0.9, 0.2), (0.3, 0.95)])
def test_log_odds_of_both_networks_are_added(tmp_path, first, second):
    found = detector(tmp_path, first, [(*MIDDLE, 1, second)]).detect(image())
    # float32, and the fake's objectness, cost a little
    expected = expit(GAIN * log_odds(first) + WEIGHT * log_odds(second) + SHIFT)
    assert found.scores[0] == pytest.approx(expected, abs=1e-3)
    assert np.allclose(found.boxes[0], BOX, atol=0.5)


def test_what_the_second_look_sees_beside_the_middle_does_not_count(tmp_path):
    beside = [(15.0, 55.0, 33.0, 73.0, 1, 0.95)]
    assert len(detector(tmp_path, 0.5, beside).detect(image())) == 0
    assert len(detector(tmp_path, 0.5, [(*MIDDLE, 1, 0.95)]).detect(image())) == 1


@pytest.mark.parametrize(('box', 'score'), [(BOX, 0.04), ((300.0, 300.0, 500.0, 420.0), 0.5)])
def test_faint_and_large_candidates_keep_their_score(tmp_path, box, score):
    candidates = detector(tmp_path, score, [(*MIDDLE, 1, 0.95)], box=box).candidates(image(), 0.02)
    assert candidates.probabilities[:, 1].max() == pytest.approx(score, abs=1e-3)


def test_without_metadata_nothing_is_looked_at_again(tmp_path):
    found = detector(tmp_path, 0.6, [(*MIDDLE, 1, 0.1)], second_look='').detect(image())
    assert found.scores[0] == pytest.approx(0.6, abs=1e-3)


@pytest.mark.parametrize('text', ['[1, 2]', '[1, 2, "x"]', '{', '[1, 2, 99]', '7'])
def test_a_combination_that_is_none_is_named(tmp_path, text):
    with pytest.raises(ModelError, match='second_look'):
        detector(tmp_path, 0.5, [(*MIDDLE, 1, 0.5)], second_look=text)


def test_an_object_fills_a_third_of_its_window_wherever_it_is():
    picture = np.full((200, 300, 3), 200, np.uint8)
    picture[90:110, 140:170] = 10
    picture[0:30, 280:300] = 10  # cut at a corner
    padding = np.array([20.0, 18.0])
    boxes = np.array([[130.0, 81.0, 180.0, 119.0], [270.0, -9.0, 320.0, 39.0]])
    middle, corner = windows(picture, boxes, padding)
    dark = np.argwhere(middle[..., 0] < 100)
    assert np.abs(dark.min(0) - SIDE * (0.5 - np.array([20, 30]) / 180)).max() <= 2
    assert np.abs(dark.max(0) - SIDE * (0.5 + np.array([20, 30]) / 180)).max() <= 2
    assert corner[SIDE // 2, SIDE // 2].max() < 100
    assert corner[:, 0].min() > 100


def test_probabilities_agree_with_logistic_regression():
    first, second = np.array([0.1, 0.5, 0.99]), np.array([0.0, 0.5, 1.0])
    odds = SecondLook(1.0, 0.0, 0.0).combined(first, second)
    assert np.allclose(odds, first, atol=1e-6)
    assert SecondLook(0.0, 1.0, -1.0).combined(np.array(0.3), np.array(0.5)) == pytest.approx(expit(-1.0))
