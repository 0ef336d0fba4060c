"""Every export in use, with and without names, in both precisions; and files that are no detector."""

import numpy as np
import onnxruntime
import pytest
import yolo_models

from av_vision import Detector, DetectorSettings, ModelError, Region

LAYOUTS = ['yolox_raw', 'yolox', 'v8', 'v5', 'end_to_end']
NAMES = {'names': "{0: 'bird', 1: 'drone', 2: 'kite'}"}


@pytest.mark.parametrize('half', [False, True])
@pytest.mark.parametrize('layout', LAYOUTS)
def test_every_export_is_recognised_and_decoded(tmp_path, layout, half):
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', layout, metadata=NAMES, half=half))
    image = np.zeros((832, 832, 3), np.uint8)  # twice the input: boxes come back twice as large
    found = detector.detect(image)
    assert found.class_names == ('drone', 'bird')
    expected = 2.0 * np.array([box[:4] for box in yolo_models.TRUTH])
    assert found.boxes == pytest.approx(expected, abs=2.0 if half else 1e-3)
    assert found.scores == pytest.approx([0.9, 0.6], abs=2e-3)


def test_raw_heads_beside_the_table_are_left_out(tmp_path):
    """As YOLOv5 exported them before 6.1."""
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', 'v5', heads=3))
    assert len(detector.detect(np.zeros((416, 416, 3), np.uint8))) == len(yolo_models.TRUTH)


@pytest.mark.parametrize('shape', [(512, 640), (640, 480), (100, 1000)])
def test_boxes_come_back_at_any_shape(tmp_path, shape):
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata=NAMES))
    scale = max(shape) / 416
    found = detector.detect(np.zeros((*shape, 3), np.uint8))
    expected = np.array([box[:4] for box in yolo_models.TRUTH]) * scale
    expected = np.clip(expected, 0, [shape[1], shape[0]] * 2)
    assert found.boxes == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(('box', 'shape'), [((390, 100, 424, 130), (416, 416)), ((-12, -6, 20, 24), (416, 416)),
                                            ((100, 180, 140, 218), (208, 416))])
def test_the_middle_of_a_box_that_reaches_beyond_the_image_stays(tmp_path, box, shape):
    """It is the bearing: padded boxes of what is at an edge, and objects that go on beyond it."""
    output = yolo_models.rows_of('v8', 416, 3, ((*box, 1, 0.9),))[None]
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', metadata=NAMES, output=output))
    found = detector.detect(np.zeros((*shape, 3), np.uint8))
    assert found.boxes == pytest.approx(np.array([box]), abs=1e-3)


def test_names_are_kept_renamed_and_checked(tmp_path):
    path = yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata=NAMES)
    only = Detector(path, DetectorSettings(keep=('drone',))).detect(np.zeros((416, 416), np.uint8))
    assert only.class_names == ('drone',)
    both = Detector(path, DetectorSettings(keep=('drone',), rename={'bird': 'drone'})).detect(np.zeros((416, 416), np.uint16))
    assert both.class_names == ('drone', 'drone')
    with pytest.raises(ModelError, match=r"has the classes .*bird.*, not \['plane'\]: .*--classes of detect"):
        Detector(path, DetectorSettings(keep=('plane',)))
    with pytest.raises(ModelError, match=r"not \['airplane'\]"):
        Detector(path, DetectorSettings(rename={'airplane': 'drone'}))
    with pytest.raises(ModelError, match='3 classes, but 2'):
        Detector(path, DetectorSettings(class_names=('a', 'b')))


def test_without_metadata_classes_are_numbered_or_coco(tmp_path):
    found = Detector(yolo_models.write(tmp_path / 'a.onnx', 'v8')).detect(np.zeros((416, 416, 3), np.uint8))
    assert found.class_names == ('class_1', 'class_0')
    found = Detector(yolo_models.write(tmp_path / 'b.onnx', 'yolox_raw', classes=80)).detect(np.zeros((416, 416, 3), np.uint8))
    assert found.class_names == ('bicycle', 'person')
    found = Detector(yolo_models.write(tmp_path / 'c.onnx', 'end_to_end')).detect(np.zeros((416, 416, 3), np.uint8))
    assert found.class_names == ('class_1', 'class_0')


def test_dynamic_input_takes_the_size_asked_for(tmp_path):
    path = yolo_models.write(tmp_path / 'model.onnx', 'v8', side=416, dynamic=True, metadata=NAMES)
    detector = Detector(path, DetectorSettings(input_size=416))
    assert detector.detect(np.zeros((416, 416, 3), np.uint8)).boxes[0] == pytest.approx(yolo_models.TRUTH[0][:4])
    with pytest.raises(ModelError, match='multiple of 32'):
        Detector(path, DetectorSettings(input_size=417))
    with pytest.raises(ModelError, match='fixed input 416x416'):
        Detector(yolo_models.write(tmp_path / 'fixed.onnx'), DetectorSettings(input_size=640))


@pytest.mark.parametrize('times', [1, 2, 4])
def test_boxes_are_padded_in_any_image_as_they_are_in_the_input(tmp_path, times):
    path = yolo_models.write(tmp_path / 'model.onnx', metadata=NAMES | {'padding': '[20, 18]'})
    found = Detector(path).detect(np.zeros((416 * times, 416 * times, 3), np.uint8))
    given = np.array([box[:4] for box in yolo_models.TRUTH])
    tight = given + 0.5 * np.array([20, 18, -20, -18])
    assert found.boxes == pytest.approx(times * tight - 0.5 * np.array([20, 18, -20, -18]), abs=1e-3)


@pytest.mark.parametrize('padding', ['wide', '[20]', '[20, -1]', '[20, "a"]', '[[1, 2], [3, 4]]', '[nan, 3]', '20'])
def test_a_padding_that_is_none_is_refused(tmp_path, padding):
    with pytest.raises(ModelError, match='padding'):
        Detector(yolo_models.write(tmp_path / 'model.onnx', metadata=NAMES | {'padding': padding}))


@pytest.mark.parametrize(('near', 'twice'), [(128, True), (160, False)])
def test_large_objects_are_searched_in_a_smaller_copy(tmp_path, near, twice):
    answer = yolo_models.rows_of('v8', 416, 3, truth=((10, 10, 50, 40, 1, 0.9), (200, 200, 210, 212, 0, 0.6)))[None]
    path = yolo_models.write(tmp_path / 'model.onnx', dynamic=True, output=answer, metadata=NAMES | {'near_imgsz': str(near)})
    found = Detector(path, DetectorSettings(input_size=416)).detect(np.zeros((416, 416, 3), np.uint8))
    # In the copy all is 3.25 times as large as it seems; of that the first is more than a quarter of the image. A copy of
    # more than a third of the input would cost too much.
    expected = {(10, 10, 50, 40), (200, 200, 210, 212)} | ({(32.5, 32.5, 162.5, 130)} if twice else set())
    assert {tuple(np.round(box, 1).tolist()) for box in found.boxes} == expected


@pytest.mark.parametrize('near', ['large', '-32', '100', '[320]'])
def test_a_size_for_what_is_near_that_is_none_is_refused(tmp_path, near):
    with pytest.raises(ModelError, match='near_imgsz'):
        Detector(yolo_models.write(tmp_path / 'model.onnx', metadata=NAMES | {'near_imgsz': near}))


@pytest.mark.parametrize('names', ["{None: 'drone'}", "{(1, 2): 'drone'}", "{'one': 'drone'}", "{1e999: 'drone'}"])
def test_names_without_numbers_are_refused(tmp_path, names):
    with pytest.raises(ModelError, match='the keys of names'):
        Detector(yolo_models.write(tmp_path / 'model.onnx', metadata={'names': names}))


def test_metadata_that_are_no_literals_are_refused_by_their_key(tmp_path):
    with pytest.raises(ModelError, match='padding'):
        Detector(yolo_models.write(tmp_path / 'model.onnx', metadata={'padding': '{[]: 1}'}))


@pytest.mark.parametrize(('output', 'reason'), [
    (np.zeros((1, 1000)), r'shape \(1, 1000\)'), (np.zeros((1, 100, 9)), 'no known YOLO export'),
    (np.zeros((1, 8400, 85)), r'\(1, 3549, 5\+C\)'), (np.zeros((2, 300, 6)), 'expected')])
def test_other_networks_are_refused_with_a_reason(tmp_path, output, reason):
    with pytest.raises(ModelError, match=reason):
        Detector(yolo_models.write(tmp_path / 'model.onnx', output=output))


@pytest.mark.parametrize('layout', ['yolox_raw', 'yolox', 'v8', 'v5'])
@pytest.mark.parametrize(('score', 'reason'), [(np.nan, 'no score is a finite number'), (-5.0, 'logits')])
def test_scores_that_are_none_are_refused(tmp_path, layout, score, reason):
    """Weights of NaN, or an export without its sigmoid: seeing nothing would be taken for an empty sky."""
    output = yolo_models.rows_of(layout, 416, 3)[None]
    (output[0, 4:] if layout == 'v8' else output[0, :, 4:])[:] = score
    with pytest.raises(ModelError, match=reason):
        Detector(yolo_models.write(tmp_path / 'model.onnx', output=output))


def test_files_that_are_no_model(tmp_path):
    good = yolo_models.write(tmp_path / 'good.onnx').read_bytes()
    for name, content, reason in [('empty', b'', '0 bytes'), ('truncated', good[:len(good) // 2], 'no ONNX model'),
                                  ('text', b'hello', 'no ONNX model')]:
        path = tmp_path / f'{name}.onnx'
        path.write_bytes(content)
        with pytest.raises(ModelError, match=reason):
            Detector(path)
    with pytest.raises(ModelError, match='does not exist'):
        Detector(tmp_path / 'missing.onnx')
    with pytest.raises(ModelError, match='task'):
        Detector(yolo_models.write(tmp_path / 'seg.onnx', metadata={'task': 'segment'}))


def test_a_missing_provider_and_wrong_settings_are_named(tmp_path):
    path = yolo_models.write(tmp_path / 'model.onnx')
    with pytest.raises(ModelError, match='CUDAExecutionProvider.*CPUExecutionProvider'):
        Detector(path, DetectorSettings(providers=('CUDAExecutionProvider',)))
    with pytest.raises(ModelError, match='CUDAExecutoinProvider, which is none .* nearest is CUDAExecutionProvider'):
        Detector(path, DetectorSettings(providers=('CUDAExecutoinProvider', 'CPUExecutionProvider')))
    with pytest.raises(ValueError, match='score_threshold is 2'):
        DetectorSettings(score_threshold=2.0)


def test_providers_that_are_not_installed_are_left_out_of_the_order(tmp_path, monkeypatch):
    path = yolo_models.write(tmp_path / 'model.onnx')
    order = ('TensorrtExecutionProvider', 'CUDAExecutionProvider', 'CPUExecutionProvider')
    monkeypatch.setattr(onnxruntime, 'get_available_providers', lambda: ['CPUExecutionProvider'])
    assert Detector(path, DetectorSettings(providers=order)).model.provider == 'CPUExecutionProvider'


@pytest.mark.parametrize(('boxes', 'scores', 'kept'), [
    ([(100, 0, 110, 10), (101, 0, 111, 10), (109, 0, 119, 10), (50, 0, 60, 10)], (0.5, 0.9, 0.8, 0.7), [1, 2, 3]),
    ([(0, 0, 40, 40), (5, 5, 15, 15), (30, 30, 50, 50), (6, 6, 14, 14)], (0.9, 0.8, 0.7, 0.6), [0, 2]),
    ([(0, 0, 40, 40), (5, 5, 15, 15), (30, 30, 50, 50), (6, 6, 14, 14)], (0.6, 0.7, 0.8, 0.9), [3, 2])])
def test_the_best_of_each_place_is_kept_and_what_is_part_of_a_likelier_thing_is_none(tmp_path, boxes, scores, kept):
    """A quarter of the third box of the latter lies in the first."""
    truth = [(*box, 1, score) for box, score in zip(boxes, scores, strict=True)]
    path = yolo_models.write(tmp_path / 'model.onnx', output=yolo_models.rows_of('v8', 416, 3, truth)[None])
    found = Detector(path).detect(np.zeros((416, 416, 3), np.uint8))
    assert np.rint(found.boxes).tolist() == [list(boxes[k]) for k in kept]


def test_a_likely_bird_in_the_same_place_is_no_drone(tmp_path):
    seen = yolo_models.rows_of('v8', 416, 3, ((96.0, 160.0, 160.0, 200.0, 0, 0.9), (98.0, 160.0, 158.0, 204.0, 1, 0.6)))
    path = yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata=NAMES, output=seen[None])
    assert Detector(path).detect(np.zeros((416, 416, 3), np.uint8)).class_names == ('bird',)
    assert len(Detector(path, DetectorSettings(keep=('drone',))).detect(np.zeros((416, 416, 3), np.uint8))) == 0


@pytest.mark.parametrize('half', [False, True])
@pytest.mark.parametrize(('shape', 'size', 'shown'), [((50, 100), 0, 208 / 416), ((300, 1000), 416, 125 / 128)])
def test_the_network_is_given_the_image_in_rgb_from_0_to_1_on_grey(tmp_path, half, shape, size, shown):
    """One that answers with the mean of each channel: of a fixed square, and of multiples of 32 into which an image fits."""
    path = yolo_models.write_means(tmp_path / 'means.onnx', dynamic=bool(size), half=half)
    image = np.full((*shape, 3), (60, 120, 240), np.uint8)
    means, = Detector(path, DetectorSettings(input_size=size)).candidates(image, 0.01).probabilities
    assert means == pytest.approx((shown * np.array([240, 120, 60]) + (1.0 - shown) * 114) / 255, abs=3e-3)


@pytest.mark.parametrize(('x', 'kept'), [(0, ['left', 'middle']), (200, ['middle']), (416, ['right', 'middle'])])
def test_what_an_inner_edge_of_a_region_cuts_is_left_to_other_regions(tmp_path, x, kept):
    places = {'left': (0, 100, 30, 130), 'right': (386, 200, 416, 230), 'middle': (200, 300, 230, 330)}
    truth = [(*place, 1, 0.9) for place in places.values()]
    path = yolo_models.write(tmp_path / 'model.onnx', output=yolo_models.rows_of('v8', 416, 3, truth)[None])
    found = Detector(path).candidates(np.zeros((416, 832, 3), np.uint8), 0.3, [Region('tile', x, 0, 416, 416, 416)])
    assert sorted(np.rint(found.boxes - [x, 0, x, 0]).tolist()) == sorted(list(places[name]) for name in kept)


def test_doubtful_numbers_are_left_out(tmp_path):
    output = yolo_models.rows_of('v8', 416, 3)[None]
    output[0, 0, 40] = np.nan  # the better copy of the first object
    output[0, 4:, 41] = np.nan
    found = Detector(yolo_models.write(tmp_path / 'model.onnx', output=output)).detect(np.zeros((416, 416, 3), np.uint8))
    assert np.isfinite(found.boxes).all()
    assert found.class_names == ('class_0',)
