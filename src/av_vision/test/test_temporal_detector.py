"""A detector with a memory, on networks whose answers are known."""

import json
from itertools import pairwise

import numpy as np
import pytest
import yolo_models
from scipy.special import expit, logit

from av_vision import Candidates, Detector, DetectorSettings, TemporalDetector

NAMES = {'names': "{0: 'bird', 1: 'drone'}", 'score_threshold': '0.5'}
TIMED = {**NAMES, 'score_fusion': json.dumps({'prior': -1.0, 'correlation': 1.0, 'memory_s': 3.0, 'floor': 0.02})}
IMAGE = np.zeros((416, 416, 3), np.uint8)
BOX = (96.0, 160.0, 160.0, 200.0)
FAINT = 0.1    # sizes/s^2, acceleration that the noise of boxes may give


def detector(folder, score, metadata=TIMED, label=1):
    rows = yolo_models.rows_of('v8', 416, 2, ((*BOX, label, score),))[None]
    path = yolo_models.write(folder / f'{label}_{score}.onnx', 'v8', metadata=metadata, output=rows)
    return Detector(path, DetectorSettings(keep=('drone',)))


def play(folder, *looks, metadata=TIMED, temporal_fusion=True):
    """Scores and tracks that follow from networks of these scores in turn, None where nothing is reported."""
    detection, out = TemporalDetector(detector(folder, 0.9, metadata), temporal_fusion=temporal_fusion), []
    for k, (score, label) in enumerate(looks):
        seen = detector(folder, score, metadata, label).candidates(IMAGE, detection.model.floor)
        found, tracks = detection.fuse(seen, 0.1 * k)
        assert len(tracks) == len(found)
        out.append((float(found.scores[0]), tracks[0]) if len(found) else None)
    return out


def test_the_first_image_is_reported_at_once_and_as_it_is(tmp_path):
    found, tracks = TemporalDetector(detector(tmp_path, 0.8)).detect(IMAGE, 0.0)
    assert found.scores == pytest.approx([0.8], abs=1e-4)
    assert tracks == [1]


def test_a_weak_image_of_a_certain_object_is_still_a_drone(tmp_path):
    alone = play(tmp_path, (0.9, 1), (0.9, 1), (0.3, 1), metadata=NAMES)
    assert alone[2] is None
    timed = play(tmp_path, (0.9, 1), (0.9, 1), (0.3, 1))
    weights = np.exp([-0.2 / 3, -0.1 / 3, 0.0])
    assert timed[2] == (pytest.approx(expit(weights @ logit([0.9, 0.9, 0.3]) / weights.sum()), abs=1e-3), 1)
    assert play(tmp_path, (0.9, 1), (0.9, 1), (0.3, 1), temporal_fusion=False)[2] is None


def test_one_drone_in_a_row_of_birds_is_a_bird(tmp_path):
    looks = [(0.9, 0)] * 5 + [(0.7, 1)]
    assert play(tmp_path, *looks)[5] is None
    assert play(tmp_path, *looks, metadata=NAMES)[5] == (pytest.approx(0.7, abs=1e-4), 1)


def test_an_image_of_another_size_begins_anew(tmp_path):
    detection = TemporalDetector(detector(tmp_path, 0.8))
    assert detection.detect(IMAGE, 0.0)[1] == detection.detect(IMAGE, 0.1)[1] == [1]
    assert detection.detect(np.zeros((832, 832, 3), np.uint8), 0.2)[1] == [2]


def test_tracks_have_a_threshold_of_their_own_unless_the_user_sets_one(tmp_path):
    higher = {**NAMES, 'score_fusion': json.dumps({'memory_s': 3.0, 'floor': 0.02, 'threshold': 0.7})}
    assert play(tmp_path, (0.6, 1), metadata=NAMES)[0] is not None
    assert play(tmp_path, (0.6, 1), metadata=higher)[0] is None
    assert play(tmp_path, (0.75, 1), metadata=higher)[0] is not None
    model = detector(tmp_path, 0.6, higher).model.path
    users = TemporalDetector(Detector(model, DetectorSettings(keep=('drone',), score_threshold=0.5)))
    assert len(users.detect(IMAGE, 0.0)[0]) == 1


def test_motion_counts_against_what_flies_straight(tmp_path):
    gain, neutral = 1.0, 1.4
    model = detector(tmp_path, 0.95, {**TIMED, 'motion': json.dumps({'gain': gain, 'neutral': neutral})})
    times = np.arange(31) / 15.0
    scores = {}
    for name, bent in (('straight', 0.0), ('bent', 1.5)):
        detection = TemporalDetector(model)
        for time in times:
            x, y = 100.0 + 20.0 * time, 100.0 + 0.5 * bent * 20.0 * time**2  # sizes of 20 pixels
            box = np.array([[x - 10, y - 10, x + 10, y + 10]], np.float32)
            found, _ = detection.fuse(Candidates(box, np.array([[0.01, 0.95]], np.float32)), time)
        scores[name] = float(found.scores[0])
    assert scores['straight'] - scores['bent'] < 0.0
    difference = logit(scores['bent']) - logit(scores['straight'])
    assert difference == pytest.approx(gain * np.log((neutral + FAINT) / FAINT), abs=0.02)


CALIBRATED = {**NAMES, 'score_fusion': json.dumps({'prior': -0.8, 'correlation': 1.0, 'memory_s': 3.0, 'floor': 0.02,
                                                   'threshold': 0.4})}


def followed(folder, *boxes):
    """Scores of what is reported in the last of some images: a drone of 60 pixels that flies by, then `boxes`.

    A box is its distance in pixels from where the drone would be, its side, and its scores as bird and drone.
    """
    detection = TemporalDetector(detector(folder, 0.9, CALIBRATED))
    for k in range(12):
        x, looks = 80.0 + 6.0 * k, boxes if k == 11 else [(0.0, 60.0, 0.001, 0.95)]
        corners = [[x + off - side / 2, 200 - side / 2, x + off + side / 2, 200 + side / 2] for off, side, *_ in looks]
        candidates = Candidates(np.float32(corners).reshape(-1, 4), np.float32([look[2:] for look in looks]).reshape(-1, 2))
        found, _ = detection.fuse(candidates, 0.1 * k)
    missed = detection._tracker.tracks[0].time < 0.1 * k
    return found.scores.tolist(), missed


def test_a_wrong_box_does_not_inherit_the_score_of_a_good_track(tmp_path):
    """A tree beside the drone that was a bird to 0.05: it is nothing, and the drone was missed in that image."""
    for off, side in ((50.0, 60.0), (25.0, 70.0), (0.0, 150.0), (-90.0, 55.0)):
        assert followed(tmp_path, (off, side, 0.05, 0.004)) == ([], 1), (off, side)
    # beside the drone itself it costs nothing
    scores, missed = followed(tmp_path, (1.0, 61.0, 0.001, 0.9), (40.0, 70.0, 0.05, 0.004))
    assert scores == [pytest.approx(0.95, abs=0.03)] and missed == 0


def test_a_weak_box_where_the_track_expects_it_is_still_the_drone(tmp_path):
    """Of the right boxes in clips 4 % have scores of their own below 0.28."""
    for off, side, drone in ((2.0, 60.0, 0.2), (4.0, 55.0, 0.3), (0.0, 62.0, 0.1)):
        (score,), missed = followed(tmp_path, (off, side, 0.01, drone))
        assert score > 0.7 and missed == 0, (off, side, drone)


def test_a_doubtful_box_has_its_own_score_as_far_as_it_is_doubtful(tmp_path):
    """From where the track expects it to where it cannot be: from the track's score to the box's own, never beyond them."""
    scores = [followed(tmp_path, (off, 60.0, 0.01, 0.5))[0][0] for off in np.arange(0.0, 200.0, 10.0)]
    assert scores[0] > 0.85 and scores[-1] == pytest.approx(0.5, abs=1e-3)
    assert all(0.5 - 1e-3 <= after <= before + 0.02 for before, after in pairwise(scores))


def test_a_camera_that_shakes_without_telling_its_pose_loses_no_drone(tmp_path):
    (score,), missed = followed(tmp_path, (45.0, 60.0, 0.001, 0.95))
    assert score > 0.85 and missed == 0


@pytest.mark.parametrize('rate', [5, 15, 60, 240])
def test_a_drone_that_is_hidden_for_a_while_is_the_same_one_at_any_rate_of_the_camera(tmp_path, rate):
    """Boxes jitter by 0.7 pixels, 20 pixels large, at 10 pixels/s: from two images of 240 a second it would be at 240."""
    model, kept = detector(tmp_path, 0.9), 0
    for seed in range(20):
        detection, rng = TemporalDetector(model), np.random.default_rng(seed)
        for time in (*np.arange(2 * rate) / rate, 2.6):
            low = np.array([200.0 + 10.0 * time, 150.0]) + rng.normal(0.0, 0.7, 2)
            _, tracks = detection.fuse(Candidates(np.float32([[*low, *(low + 20.0)]]), np.float32([[0.02, 0.9]])), time)
        kept += tracks == [1]
    assert kept == 20


def test_what_is_withheld_for_its_motion_is_no_empty_view(tmp_path):
    """A speck that rests and looks like a drone may be one: neither is it reported, nor is its image one without a drone."""
    speck = {**CALIBRATED, 'motion': json.dumps({'speck': 8.0, 'bend': 16.0, 'bends': 1.2, 'rests': 2.94})}
    for drone, empty in ((0.9, False), (0.2, True)):    # by its own score
        detection, rng = TemporalDetector(detector(tmp_path, 0.9, speck)), np.random.default_rng(0)
        for k in range(30):
            low = np.array([100.0, 80.0]) + rng.normal(0.0, 0.3, 2)
            found, _ = detection.fuse(Candidates(np.float32([[*low, *(low + 6.0)]]), np.float32([[0.01, drone]])), 0.1 * k)
            assert len(found) == 0 and detection.searched(0.1 * k) == empty, (drone, k)
        detection.fuse(Candidates(np.empty((0, 4), np.float32), np.empty((0, 2), np.float32)), 3.0)
        assert detection.searched(3.0), 'gone, and looked for'


@pytest.fixture(scope='module')
def networks(tmp_path_factory):
    """Detectors that report all classes, without and with a memory, and one of low threshold."""
    folder = tmp_path_factory.mktemp('networks')
    plain, timed = (yolo_models.write(folder / f'{name}.onnx', 'v8', classes=2, metadata=metadata)
                    for name, metadata in (('plain', NAMES), ('timed', TIMED)))
    return {'plain': Detector(plain), 'timed': Detector(timed),
            'low': Detector(timed, DetectorSettings(score_threshold=0.03))}


def seen(*centres, size=20.0, drone=0.9, bird=0.05):
    centres = np.array(centres, np.float32).reshape(-1, 2)
    return Candidates(np.concatenate([centres - size / 2, centres + size / 2], 1),
                      np.tile(np.float32([bird, drone]), (len(centres), 1)))


def test_a_number_survives_a_gap_and_not_a_long_one(networks):
    detection = TemporalDetector(networks['plain'])
    for k in range(10):
        assert detection.fuse(seen((100 + 6 * k, 50)), k / 30)[1] == [1]
    for k in range(10, 25):
        assert detection.fuse(seen(), k / 30)[1] == []
    assert detection.fuse(seen((100 + 6 * 25, 50)), 25 / 30)[1] == [1]
    assert detection.fuse(seen((300, 50)), 5.0)[1] == [2]


def test_two_that_cross_keep_their_numbers(networks):
    detection, rng = TemporalDetector(networks['plain']), np.random.default_rng(0)
    for k in range(60):
        both, order = [(100 + 5 * k, 100 + k), (400 - 5 * k, 110 + k)], list(rng.permutation(2) if k else (0, 1))
        ids = detection.fuse(seen(*[both[i] for i in order]), k / 30)[1]
        assert [ids[order.index(0)], ids[order.index(1)]] == [1, 2]


def test_a_bird_that_is_a_drone_in_the_next_image_is_the_same_thing_and_far_things_and_those_of_another_size_are_new(networks):
    detection = TemporalDetector(networks['plain'])
    looks = [((100, 100), {}), ((102, 100), {'drone': 0.1, 'bird': 0.8}), ((400, 100), {}), ((400, 100), {'size': 200.0})]
    assert [detection.fuse(seen(place, **what), 0.03 * k)[1] for k, (place, what) in enumerate(looks)] == [[1], [1], [2], [3]]
    assert detection.fuse(seen((400, 100), size=200.0), 0.0)[1] == [4], 'time that runs backwards begins anew'


def test_a_bird_and_a_drone_that_pass_each_other_keep_their_numbers(networks):
    """In the image in which they are nearest to where the other one is expected, their classes tell them apart."""
    detection = TemporalDetector(networks['timed'])
    for k in range(10):
        gap = 14.0 if k < 9 else 1.0
        pair = seen((100, 100 - gap), (100, 100 + gap))
        looks = Candidates(pair.boxes, np.float32([[0.01, 0.9], [0.9, 0.01]]))
        ids = detection.fuse(looks, 0.1 * k)[1]
    assert ids == [1, 2]


def test_a_box_where_a_track_expects_it_is_not_left_to_another_track(networks):
    """One of two drones is hidden, and something beside the other is seen: to give each track a box would exchange them."""
    detection = TemporalDetector(networks['timed'])
    for k in range(10):
        assert detection.fuse(seen((100, 100), (111, 100)), 0.1 * k)[1] == [1, 2]
    found, tracks = detection.fuse(seen((100, 100), (83, 100)), 1.0)
    assert dict(zip(found.centres[:, 0].tolist(), tracks, strict=True)) == {100.0: 1, 83.0: 3}


def test_with_a_memory_weak_boxes_only_continue(networks):
    detection = TemporalDetector(networks['low'])
    assert detection.fuse(seen((100, 100), drone=0.05, bird=0.01), 0.0)[1] == []
    assert detection.fuse(seen((100, 100)), 0.1)[1] == [1]
    assert detection.fuse(seen((100, 100), (400, 400), drone=0.05, bird=0.01), 0.2)[1] == [1]


def test_images_make_a_mean_and_missed_ones_say_nothing(networks):
    """As the same object looks alike, many images are no surer than one; drones and other things are missed alike."""
    detection = TemporalDetector(networks['timed'])
    for k in range(40):
        found, _ = detection.fuse(seen(*[(100, 100)] * (k % 3 > 0), drone=0.8), 0.1 * k)
        assert found.scores == pytest.approx([0.8] * (k % 3 > 0), abs=1e-6)
    detection.reset()
    looks = [2.0, -0.5, 1.5, 0.6]
    for k, look in enumerate(looks):
        found, _ = detection.fuse(seen((100, 100), drone=expit(look)), 0.1 * k)
    weights = np.exp(-0.1 / 3.0 * np.arange(3, -1, -1))
    assert found.scores == pytest.approx([expit(weights @ looks / weights.sum())], abs=1e-3)


@pytest.mark.parametrize(('key', 'text'), [
    ('score_fusion', '{'), ('score_fusion', '[1]'), ('score_fusion', '{"mood": 1}'), ('score_fusion', '{"correlation": 7}'),
    ('score_fusion', '{"correlation": 0.6}'), ('score_fusion', '{"prior": "x"}'), ('motion', '{'), ('motion', '[1]'),
    ('motion', '{"gain": -1}'), ('motion', '{"mood": 1}'), ('motion', '{"gain": "x"}'), ('motion', '{"neutral": 0}')])
def test_metadata_of_another_memory_or_motion_are_refused(tmp_path, key, text):
    with pytest.raises(ValueError, match=key):
        TemporalDetector(detector(tmp_path, 0.9, {**TIMED, key: text}))
