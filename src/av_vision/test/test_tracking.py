"""Track numbers that stay with their things."""

import numpy as np
import pytest

from av_vision.detections import Candidates
from av_vision.score_fusion import ScoreFusionModel
from av_vision.tracking import BEGIN, Tracker

MEMORY = ScoreFusionModel(memory_s=3.0, floor=0.02)


def seen(*centres, size=20.0, drone=0.9, bird=0.05):
    centres = np.array(centres, np.float32).reshape(-1, 2)
    return Candidates(np.concatenate([centres - size / 2, centres + size / 2], 1),
                      np.tile(np.float32([drone, bird]), (len(centres), 1)))


def numbers(tracker, candidates, time):
    return [tracker.number(track) if track else None for track in tracker.update(candidates, time)]


def test_a_number_survives_a_gap_and_not_a_long_one():
    tracker = Tracker()
    for k in range(10):
        assert numbers(tracker, seen((100 + 6 * k, 50)), k / 30) == [1]
    for k in range(10, 25):
        assert numbers(tracker, seen(), k / 30) == []
    assert numbers(tracker, seen((100 + 6 * 25, 50)), 25 / 30) == [1]
    assert numbers(tracker, seen((300, 50)), 5.0) == [2]


def test_two_that_cross_keep_their_numbers():
    tracker = Tracker()
    rng = np.random.default_rng(0)
    left_first = None
    for k in range(60):
        left, right = (100 + 5 * k, 100 + k), (400 - 5 * k, 110 + k)
        order = list(rng.permutation(2))
        ids = numbers(tracker, seen(*[(left, right)[i] for i in order]), k / 30)
        ids = [ids[order.index(0)], ids[order.index(1)]]
        left_first = left_first or ids
        assert ids == left_first


def test_a_bird_that_is_a_drone_in_the_next_image_is_the_same_thing():
    tracker = Tracker()
    assert numbers(tracker, seen((100, 100)), 0.0) == [1]
    assert numbers(tracker, seen((102, 100), drone=0.1, bird=0.8), 0.03) == [1]


def test_far_things_and_those_of_another_size_are_new():
    tracker = Tracker()
    assert numbers(tracker, seen((100, 100)), 0.0) == [1]
    assert numbers(tracker, seen((400, 100)), 0.03) == [2]
    assert numbers(tracker, seen((400, 100), size=200.0), 0.06) == [3]


def test_a_box_where_a_track_expects_it_is_not_left_to_another_track():
    """One of two drones is hidden, and something beside the other is seen: to give each track a box would exchange them."""
    tracker = Tracker(model=MEMORY)
    for k in range(10):
        assert numbers(tracker, seen((100, 100), (111, 100)), 0.1 * k) == [1, 2]
    found = numbers(tracker, seen((100, 100), (87, 100)), 1.0)
    assert found[0] == 1 and found[1] not in (1, 2)


def test_with_a_memory_weak_boxes_only_continue():
    tracker, weak = Tracker(model=MEMORY), 0.5 * BEGIN
    assert tracker.update(seen((100, 100), drone=weak), 0.0) == [None]
    assert numbers(tracker, seen((100, 100), drone=0.9), 0.1) == [1]
    assert numbers(tracker, seen((100, 100), (400, 400), drone=weak), 0.2) == [1, None]


def test_a_missed_image_says_nothing_of_what_a_thing_is():
    """Drones and other things are missed alike."""
    tracker = Tracker(model=MEMORY)
    (track,) = tracker.update(seen((100, 100)), 0.0)
    before = track.scores.probabilities()[0]
    tracker.update(seen(), 0.1)
    assert track.scores.probabilities()[0] == before and tracker.tracks == [track] and track.time == 0.0


def test_time_that_runs_backwards_begins_anew():
    tracker = Tracker()
    assert numbers(tracker, seen((100, 100)), 10.0) == [1]
    assert numbers(tracker, seen((100, 100)), 0.0) == [2]
    with pytest.raises(ValueError, match='correlation: 2'):
        ScoreFusionModel.from_metadata({'score_fusion': '{"correlation": 2.0}'})
