"""Track numbers that stay with their objects."""

import numpy as np
import pytest

from av_vision.tracking import Tracker
from av_vision.yolo import Detections


def seen(*centres, size=20.0, names=None):
    centres = np.array(centres, np.float32).reshape(-1, 2)
    return Detections(np.concatenate([centres - size / 2, centres + size / 2], 1), np.ones(len(centres), np.float32),
                      tuple(names or ['drone'] * len(centres)))


def test_a_number_survives_a_gap_and_not_a_long_one():
    tracker = Tracker(max_gap_s=1.0)
    for k in range(10):
        assert tracker.update(seen((100 + 6 * k, 50)), k / 30) == [1]
    for k in range(10, 25):
        assert tracker.update(seen(), k / 30) == []
    assert tracker.update(seen((100 + 6 * 25, 50)), 25 / 30) == [1]
    assert tracker.update(seen((300, 50)), 5.0) == [2]


def test_two_that_cross_keep_their_numbers():
    tracker = Tracker()
    rng = np.random.default_rng(0)
    for k in range(60):
        left, right = (100 + 5 * k, 100 + k), (400 - 5 * k, 110 + k)
        order = rng.permutation(2)
        ids = tracker.update(seen(*[(left, right)[i] for i in order]), k / 30)
        assert [ids[list(order).index(0)], ids[list(order).index(1)]] == [1, 2] if k else True
        if k == 0 and ids[list(order).index(0)] == 2:
            pytest.skip('the numbering began the other way round')


def test_far_things_and_other_classes_are_new():
    tracker = Tracker()
    assert tracker.update(seen((100, 100)), 0.0) == [1]
    assert tracker.update(seen((400, 100)), 0.03) == [2]
    assert tracker.update(seen((400, 100), names=['bird']), 0.06) == [3]


def test_time_that_runs_backwards_begins_anew():
    tracker = Tracker()
    assert tracker.update(seen((100, 100)), 10.0) == [1]
    assert tracker.update(seen((100, 100)), 0.0) == [2]
