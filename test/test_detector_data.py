"""What the detector is trained and judged on: tight boxes, labels of other people's pictures, windows of them."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

TRAINING = Path(__file__).resolve().parents[1] / 'training/detector'


@pytest.fixture(scope='module', autouse=True)
def training():
    sys.path.insert(0, str(TRAINING))
    yield
    sys.path.remove(str(TRAINING))


def sky(height=200, width=300):
    rows = np.linspace(0, 30, height)[:, None, None]
    noise = np.random.default_rng(0).normal(0, 1.0, (height, width, 3))
    return np.clip(np.array([200, 160, 120]) + rows + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize('colour', [20, 120, 250])
def test_a_label_is_tightened_to_what_stands_out(colour):
    from tight import tight_box
    image = sky()
    image[90:102, 140:171] = colour
    box, seen = tight_box(image, np.array([120.0, 75.0, 185.0, 125.0]))
    assert seen
    assert np.abs(box - [140, 90, 171, 102]).max() <= 1


def test_a_bird_at_the_edge_does_not_widen_the_box():
    from tight import tight_box
    image = sky()
    image[90:102, 140:171] = 20
    image[112:115, 120:124] = 100
    box, _ = tight_box(image, np.array([110.0, 70.0, 195.0, 125.0]))
    assert np.abs(box - [140, 90, 171, 102]).max() <= 1


def test_without_plain_sky_a_label_loses_its_padding():
    from tight import PADDING, padded, tight_box
    image = np.random.default_rng(1).integers(0, 255, (200, 300, 3)).astype(np.uint8)
    tight = np.array([140.0, 90.0, 171.0, 102.0], np.float32)
    box, seen = tight_box(image, padded(tight, PADDING))
    assert not seen
    assert np.allclose(box, tight)


def test_an_empty_label_and_one_outside_the_image_are_survived():
    from tight import tightened
    boxes = np.array([[0, 310.0, 50.0, 330.0, 70.0], [0, 10.0, 10.0, 10.0, 10.0]], np.float32)
    assert tightened(sky(), boxes).shape == (2, 5)
    assert tightened(sky(), np.empty((0, 5), np.float32)).shape == (0, 5)


def place(folder, **options):
    from places import BIRD, DRONE, Place
    (folder / 'places' / 'some').mkdir(parents=True)
    (folder / 'places' / 'some' / 'whole').touch()
    return Place('some', 'nobody/nothing', '0' * 40, 'none', ('.',), (BIRD, DRONE), **options)


def picture(folder, name, label=None):
    path = folder / 'places' / 'some' / 'images' / name
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), sky())
    if label is not None:
        text = folder / 'places' / 'some' / 'labels' / f'{Path(name).stem}.txt'
        text.parent.mkdir(exist_ok=True)
        text.write_text(label)


def test_labels_of_both_kinds_become_boxes_in_pixels(tmp_path):
    from places import BIRD, DRONE, pictures
    some = place(tmp_path)
    picture(tmp_path, 'a.jpg', '1 0.5 0.5 0.2 0.1\n0 0.1 0.1 0.3 0.1 0.3 0.4 0.1 0.4\n')
    image, boxes = next(pictures(some, tmp_path)).load()
    assert image.shape == (200, 300, 3)
    assert np.allclose(boxes, [[DRONE, 120, 90, 180, 110], [BIRD, 30, 20, 90, 80]], atol=1e-3)


def test_one_version_of_a_source_and_nothing_left_out_is_read(tmp_path):
    from places import pictures
    some = place(tmp_path, without='/Svanstrom_', whole=False)
    for name in ('a_jpg.rf.1.jpg', 'a_jpg.rf.2.jpg', 'Svanstrom_3.jpg'):
        picture(tmp_path, name, '1 0.5 0.5 0.2 0.1\n')
    picture(tmp_path, 'unlabelled.jpg')
    assert [one.path.name for one in pictures(some, tmp_path)] == ['a_jpg.rf.1.jpg']


def test_judged_pictures_are_no_training_pictures():
    from album import SHARES
    from places import JUDGED, SOURCES
    assert not {place.repository for place in JUDGED} & {place.repository for place in SOURCES}
    assert SHARES.keys() == {place.name for place in SOURCES}


@pytest.mark.parametrize('side', [128, 416, 640])
def test_boxes_stay_on_their_objects_in_windows(side):
    from album import view_of
    image = sky()
    image[80:110, 130:180] = (0, 0, 255)
    truth = np.array([[0, 130, 80, 180, 110]], np.float32)
    seen = 0
    for seed in range(40):
        view, boxes = view_of(np.random.default_rng(seed), image, truth, side)
        assert view.shape == (side, side, 3)
        red = (view[..., 2].astype(int) - view[..., 0]) > 120
        if not len(boxes) or red.sum() < 20:
            continue
        rows, columns = np.nonzero(red)
        found = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert np.abs(boxes[0, 1:] - found).max() <= 2.5 + 0.03 * side
        seen += 1
    assert seen > 20


def test_motion_is_fitted_as_two_normal_distributions_demand():
    from flight import fit

    from av_vision.motion import FAINT
    rng, count = np.random.default_rng(0), 4000
    mean, spread = {'DRONE': 0.6, 'AIRPLANE': -1.0, 'HELICOPTER': -1.0, 'BIRD': 0.0}, 0.9
    kinds = np.repeat(list(mean), [count, 2 * count, count // 2, count])  # each class counts alike, birds do not
    accelerations = np.abs(np.exp([mean[kind] for kind in kinds] + spread * rng.normal(size=len(kinds))) - FAINT)
    sizes = np.where(np.arange(len(kinds)) % 2, 5.0, 20.0)  # pixels; the bends of small drones are a log-normal, too
    model = fit(kinds, np.ones(len(kinds)), accelerations, sizes)
    assert model.gain == pytest.approx(1.6 / spread**2, rel=0.05)  # difference of the means over the variance
    assert np.log(model.neutral + FAINT) == pytest.approx(-0.2, abs=0.05)  # half way between them
    bends = 5.0 * accelerations[(kinds == 'DRONE') & (sizes < 8.0)]
    assert model.bend == pytest.approx(float(np.median(bends)), rel=0.01)


def test_paths_of_labels_have_the_motion_that_was_written(tmp_path):
    from clips import split_of
    from flight import paths
    (tmp_path / 'labels').mkdir()
    number = next(n for n in range(100) if split_of(f'V_AIRPLANE_{n:03d}') == 'train')
    rows, size = ['frame,label,x,y,width,height'], 30.0  # and the padding of labels
    for frame in range(100):
        time = frame / 30.0
        x, y = 100.0 + 60.0 * time, 200.0 + 0.5 * 15.0 * time**2
        rows.append(f'{frame},AIRPLANE,{x},{y},{size + 20},{size - 10 + 18}')
    (tmp_path / f'labels/V_AIRPLANE_{number:03d}.csv').write_text('\n'.join(rows))
    found = list(paths(tmp_path, 'train'))
    assert len(found) >= 3
    for kind, speed, acceleration, pixels in found:
        assert kind == 'AIRPLANE' and pixels == pytest.approx(size)
        assert speed >= 60.0 / size
        assert acceleration == pytest.approx(15.0 / size, rel=1e-3)


def test_a_picture_with_a_balloon_says_so(tmp_path):
    from places import SOURCES, pictures
    flying = next(place for place in SOURCES if place.name == 'flying')
    folder = tmp_path / 'places/flying'
    for name, label in (('a', '3 0.5 0.5 0.2 0.2'), ('b', '2 0.5 0.5 0.2 0.2'), ('c', '2 0.3 0.3 0.2 0.2\n3 0.7 0.7 0.1 0.1')):
        for part in ('images', 'labels'):
            (folder / f'Dataset/train/{part}').mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / f'Dataset/train/images/{name}.jpg'), sky())
        (folder / f'Dataset/train/labels/{name}.txt').write_text(label)
    (folder / 'whole').touch()
    assert [(one.nameless, len(one.boxes)) for one in pictures(flying, tmp_path)] == [(True, 0), (False, 1), (True, 1)]


def test_the_sun_saturates_and_an_insect_is_a_blurred_thing_in_the_middle():
    from painted import insect, sunlit
    for seed in range(10):
        rng = np.random.default_rng(seed)
        plain = np.full((200, 240, 3), 60, np.uint8)
        lit = sunlit(rng, plain)
        assert (lit >= plain).all()
        assert lit.min(axis=2).max() > 200
        alpha = insect(rng)[..., 3].astype(float)
        assert alpha.max() > 20
        assert alpha[0].max() == alpha[-1].max() == 0.0
        assert np.abs(np.gradient(alpha)[0]).max() < 100.0  # no sharp edge


def test_looks_a_second_are_those_of_the_log_of_a_run(tmp_path):
    from live import looks

    from av_evaluation.metrics.run_log import RunLog
    log = RunLog()
    for number in range(11):
        log.sight.add(100.0 + 0.1 * number, 0.2, 0.9, 0.05)
    log.save(tmp_path)
    assert looks(tmp_path / 'sight.csv') == pytest.approx((10.0, 0.05))
