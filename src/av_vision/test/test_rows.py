"""Tables of boxes of other exports: recognised by their values, or refused with what was seen."""

from pathlib import Path

import numpy as np
import onnx
import pytest
import yolo_models
from onnx import TensorProto, helper, numpy_helper

from av_vision import Detector, DetectorSettings, ModelError
from av_vision.cli import detect
from av_vision.yolo.layout import Layout
from av_vision.yolo.rows import readings

SIDE = 416
NAMES = {'names': "{0: 'bird', 1: 'drone', 2: 'kite'}"}
IMAGE = np.zeros((SIDE, SIDE, 3), np.uint8)
# x1, y1, x2, y2 in pixels, class, score; the others are background.
SEEN = ((96.0, 160.0, 160.0, 200.0, 1, 0.9), (300.0, 40.0, 340.0, 100.0, 0, 0.6))


def table(seed=0, count=100, seen=SEEN):
    """Boxes (n, 4) in pixels, classes and scores: what is seen among doubtful background."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(0.0, 0.8 * SIDE, (count, 2))
    boxes = np.concatenate([low, low + rng.uniform(5.0, 0.2 * SIDE, (count, 2))], axis=1)
    labels, scores = rng.integers(0, 3, count), rng.uniform(0.0, 0.05, count)
    for row, (*box, label, score) in zip((7, 31), seen, strict=False):
        boxes[row], labels[row], scores[row] = box, label, score
    return boxes, labels, scores


def centred(boxes):
    return np.concatenate([0.5 * (boxes[:, :2] + boxes[:, 2:]), boxes[:, 2:] - boxes[:, :2]], axis=1)


def by_class(labels, scores, classes=3):
    return scores[:, None] * np.eye(classes)[labels] + 0.001


def columns(*parts):
    return np.concatenate([np.reshape(part, (len(part), -1)) for part in parts], axis=1)[None]


def exports():
    boxes, labels, scores = table()
    zeros = np.zeros(len(boxes))
    return {
        'YOLOv10': columns(boxes, scores, labels),
        'class before score': columns(boxes, labels, scores),
        'class, score, box': columns(labels, scores, boxes),
        'score, class, box': columns(scores, labels, boxes),
        'corners in shares': columns(boxes / SIDE, scores, labels),
        'centres in pixels': columns(centred(boxes), scores, labels),
        'batch, box, class, score': columns(zeros, boxes, labels, scores),
        'batch, class, score, box in shares': columns(zeros, labels, scores, boxes / SIDE),
        'RT-DETR': columns(centred(boxes) / SIDE, by_class(labels, scores)),
        'a score for each class': columns(boxes, by_class(labels, scores)),
        'a regression without bounds': columns(
            np.where(np.arange(len(boxes))[:, None] % 20 == 5, boxes[:, [2, 1, 0, 3]], boxes), scores, labels),
        'filled up by class -1': np.concatenate([columns(boxes, scores, labels), np.tile([0, 0, 0, 0, 0, -1.0], (1, 50, 1))],
                                                axis=1),
        'filled up by -1': np.concatenate([columns(boxes, scores, labels), np.full((1, 50, 6), -1.0)], axis=1),
    }


def orders(boxes):
    """Columns of boxes (n, 4) x1, y1, x2, y2 in each order."""
    x1, y1, x2, y2 = np.asarray(boxes, float).T
    both = {'x1 y1 x2 y2': [x1, y1, x2, y2], 'x1 y1 w h': [x1, y1, x2 - x1, y2 - y1],
            'cx cy w h': [0.5 * (x1 + x2), 0.5 * (y1 + y2), x2 - x1, y2 - y1]}
    both |= {'y1 x1 y2 x2': [y1, x1, y2, x2], 'cy cx h w': [both['cx cy w h'][i] for i in (1, 0, 3, 2)]}
    return {name: np.stack(columns, axis=1) for name, columns in both.items()}


@pytest.mark.parametrize('half', [False, True])
@pytest.mark.parametrize('name', exports())
def test_tables_of_boxes_are_read_by_their_values(tmp_path, name, half):
    path = yolo_models.write(tmp_path / 'model.onnx', output=exports()[name], metadata=NAMES, half=half)
    found = Detector(path).detect(IMAGE)
    assert found.class_names == ('drone', 'bird')
    assert found.boxes == pytest.approx(np.array([row[:4] for row in SEEN]), abs=1.0 if half else 0.01)
    assert found.scores == pytest.approx([0.9, 0.6], abs=2e-3)


def write_apart(path, outputs, sizes=False):
    """A model whose boxes, classes and scores are outputs; with `sizes` an input tells what boxes are scaled to."""
    nodes, values = [helper.make_node('ReduceMean', ['images'], ['mean'], keepdims=0),
                     helper.make_node('Mul', ['mean', 'zero'], ['nothing'])], [numpy_helper.from_array(np.float32(0), 'zero')]
    inputs = [helper.make_tensor_value_info('images', TensorProto.FLOAT, ['N', 3, SIDE, SIDE])]
    for name, answer in outputs.items():
        values.append(numpy_helper.from_array(np.asarray(answer, np.float32), f'of_{name}'))
        whole = name == 'labels'
        nodes += [helper.make_node('Add', [f'of_{name}', 'nothing'], [f'sum_{name}']),
                  helper.make_node('Cast', [f'sum_{name}'], [f'cast_{name}' if sizes and name == 'boxes' else name],
                                   to=TensorProto.INT64 if whole else TensorProto.FLOAT)]
    if sizes:
        inputs.append(helper.make_tensor_value_info('orig_target_sizes', TensorProto.INT64, ['N', 2]))
        values += [numpy_helper.from_array(np.array([1]), 'axis'), numpy_helper.from_array(np.array([1, 1, 2]), 'twice')]
        nodes += [helper.make_node('Cast', ['orig_target_sizes'], ['sizes'], to=TensorProto.FLOAT),
                  helper.make_node('Unsqueeze', ['sizes', 'axis'], ['row']),
                  helper.make_node('Tile', ['row', 'twice'], ['scale']),
                  helper.make_node('Mul', ['cast_boxes', 'scale'], ['boxes'])]
    given = [helper.make_tensor_value_info(name, TensorProto.INT64 if name == 'labels' else TensorProto.FLOAT, None)
             for name in outputs]
    model = helper.make_model(helper.make_graph(nodes, 'apart', inputs, given, values),
                              opset_imports=[helper.make_opsetid('', 17)], ir_version=8)
    helper.set_model_props(model, NAMES)
    onnx.save(model, str(path))
    return path


@pytest.mark.parametrize('export', ['RT-DETR', 'with suppression', 'a score for each class', 'YOLO-NAS'])
def test_boxes_classes_and_scores_may_be_outputs_of_their_own(tmp_path, export):
    boxes, labels, scores = (part[None] for part in table())
    cells = yolo_models.grid(SIDE)
    around = np.concatenate([(cells[:, :2] - 0.5) * cells[:, 2:], (cells[:, :2] + 1.5) * cells[:, 2:]], axis=1)
    by_cell = np.full((len(cells), 3), 0.01)
    for row, (*box, label, score) in zip((40, 900), SEEN, strict=True):
        around[row], by_cell[row, label] = box, score
    path = tmp_path / 'model.onnx'
    write_apart(path, {
        'RT-DETR': {'labels': labels, 'boxes': boxes / SIDE, 'scores': scores},
        'with suppression': {'num': [[100]], 'boxes': boxes, 'scores': scores, 'labels': labels},
        'a score for each class': {'scores': by_class(labels[0], scores[0])[None], 'boxes': centred(boxes[0])[None] / SIDE},
        'YOLO-NAS': {'boxes': around[None], 'scores': by_cell[None]}}[export], sizes=export == 'RT-DETR')
    found = Detector(path).detect(IMAGE)
    assert found.class_names == ('drone', 'bird') and found.scores == pytest.approx([0.9, 0.6], abs=2e-3)
    assert found.boxes == pytest.approx(np.array([row[:4] for row in SEEN]), abs=0.01)
    write_apart(path, {'num': [[0]], 'boxes': boxes[:, :0], 'scores': scores[:, :0], 'labels': labels[:, :0]})
    assert len(Detector(path).detect(IMAGE)) == 0


def write_finder(path, order, places, shares, side=SIDE):
    """A network that finds the bright rectangle of an image, and tells it in a table of eight rows, seven of them doubtful.

    Parameters:
        order: of the four columns of the box.
        places: columns of box, score and class.
        shares: whether boxes are in shares of the input.
    """
    nodes, values = [], []

    def constant(name, value, kind=np.float32):
        values.append(numpy_helper.from_array(np.array(value, kind), name))
        return name

    def add(kind, inputs, **options):
        name = f'v{len(nodes)}'
        nodes.append(helper.make_node(kind, inputs, [name], **options))
        return name
    bright = add('Cast', [add('Greater', ['images', constant('level', 0.7)])], to=TensorProto.FLOAT)
    edges = {}
    for axis, kept in (('x', 3), ('y', 2)):
        profile = add('ReduceMax', [bright], axes=[i for i in range(4) if i != kept], keepdims=0)
        first = add('Cast', [add('ArgMax', [profile], axis=0, keepdims=1)], to=TensorProto.FLOAT)
        last = add('Cast', [add('ArgMax', [profile], axis=0, keepdims=1, select_last_index=1)], to=TensorProto.FLOAT)
        edges[axis] = first, add('Add', [last, constant(f'one{axis}', 1.0)])
    middle, size = {}, {}
    for axis, (low, high) in edges.items():
        size[axis] = add('Sub', [high, low])
        middle[axis] = add('Add', [low, add('Mul', [size[axis], constant(f'half{axis}', 0.5)])])
    columns = {'x1': edges['x'][0], 'x2': edges['x'][1], 'y1': edges['y'][0], 'y2': edges['y'][1],
               'cx': middle['x'], 'cy': middle['y'], 'w': size['x'], 'h': size['y']}
    box = add('Mul', [add('Concat', [columns[name] for name in order.split()], axis=0),
                      constant('unit', 1.0 / side if shares else 1.0)])
    score = add('ReduceMax', [bright], axes=[0, 1, 2, 3], keepdims=0)
    score = add('Add', [add('Mul', [score, constant('certain', 0.87)]), constant('doubt', 0.03)])
    score = add('Unsqueeze', [score, constant('axis', [0], np.int64)])
    first, at_score, at_class = places
    parts = {first: box, at_score: score, at_class: constant('class', [1.0])}
    row = add('Unsqueeze', [add('Concat', [parts[k] for k in sorted(parts)], axis=0), constant('axes', [0, 1], np.int64)])
    scales = np.ones((1, 8, 6))
    scales[0, 1:, at_score] = 0.05
    nodes.append(helper.make_node('Mul', [row, constant('doubts', scales)], ['output']))
    graph = helper.make_graph(nodes, 'finder', [helper.make_tensor_value_info('images', TensorProto.FLOAT, [1, 3, side, side])],
                              [helper.make_tensor_value_info('output', TensorProto.FLOAT, None)], values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 17)], ir_version=8)
    helper.set_model_props(model, NAMES)
    onnx.save(model, str(path))
    return path


@pytest.mark.parametrize('shares', [False, True])
@pytest.mark.parametrize('places', [(0, 4, 5), (2, 1, 0), (1, 5, 0)])
@pytest.mark.parametrize('order', orders(np.ones((1, 4))))
def test_a_network_that_sees_is_read_in_any_order_of_its_columns(tmp_path, order, places, shares):
    """Also where the values of one box fit several orders: large, close to the origin, in a square picture."""
    detector = Detector(write_finder(tmp_path / 'model.onnx', order, places, shares))
    assert len(detector.detect(IMAGE)) == 0
    for x, y, w, h in ((30, 60, 90, 70), (250, 100, 40, 130), (205, 10, 24, 18), (3, 290, 60, 100)):
        image = IMAGE.copy()
        image[y:y + h, x:x + w] = 255
        found = detector.detect(image)
        assert found.boxes == pytest.approx(np.array([[x, y, x + w, y + h]]), abs=1.0)
        assert found.class_names == ('drone',)
    assert f'{order} in {"shares" if shares else "pixels"}' in detector.model.columns
    assert 'assumed' not in detector.model.columns


@pytest.mark.parametrize('shares', [False, True])
@pytest.mark.parametrize('order', ['x1 y1 x2 y2', 'y1 x1 y2 x2', 'cx cy w h', 'cy cx h w'])
@pytest.mark.parametrize('layout', ['yolox', 'v8', 'v5'])
def test_cells_are_read_in_any_order_of_their_boxes(tmp_path, layout, order, shares):
    """By the cells, with what a network answers to an image of nothing: random boxes around each."""
    rng = np.random.default_rng(3)
    cells, strides = (np.concatenate([part[part_of] for part_of in (slice(0, 2704), slice(2704, 3380), slice(3380, None))
                                      for _ in range(3 if layout == 'v5' else 1)]) for part in
                      (yolo_models.grid(SIDE)[:, :2], yolo_models.grid(SIDE)[:, 2:]))
    sides = strides * rng.uniform(0.1, 6.0, (len(cells), 4))
    middles = (cells + 0.5) * strides
    boxes = np.concatenate([middles - sides[:, :2], middles + sides[:, 2:]], axis=1)
    boxes[40] = SEEN[0][:4]
    scores = rng.uniform(0.0, 0.01, (len(cells), 3))
    scores[40, 1] = 0.9
    table = np.concatenate([orders(boxes)[order] / (SIDE if shares else 1.0),
                            *([] if layout == 'v8' else [np.ones((len(cells), 1))]), scores], axis=1)
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', output=(table.T if layout == 'v8' else table)[None],
                                          metadata=NAMES))
    assert detector.detect(IMAGE).boxes == pytest.approx(np.array([SEEN[0][:4]]), abs=0.01)


@pytest.mark.parametrize('order', ['x1 y1 x2 y2', 'cx cy w h'])
@pytest.mark.parametrize('layout', ['anchors of a cell side by side', 'coarse cells first'])
def test_cells_in_another_order_tell_nothing_of_their_boxes(tmp_path, layout, order):
    """As of Darknet's networks: what is near no cell is read as most networks write it, as corners where all boxes are some."""
    rng = np.random.default_rng(3)
    cells = yolo_models.grid(SIDE)
    cells = np.repeat(cells, 3, axis=0) if layout.startswith('anchors') else cells[np.argsort(-cells[:, 2], kind='stable')]
    middles, sides = (cells[:, :2] + 0.5) * cells[:, 2:], cells[:, 2:] * rng.uniform(4.0, 12.0, (len(cells), 2))
    boxes = np.concatenate([middles - 0.5 * sides, middles + 0.5 * sides], axis=1)
    boxes[40] = SEEN[0][:4]
    scores = rng.uniform(0.0, 0.01, (len(cells), 3))
    scores[40, 1] = 0.9
    table = np.concatenate([orders(boxes)[order], scores], axis=1).T
    if layout.startswith('anchors'):
        table = np.insert(table.T, 4, 1.0, axis=1)
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', output=table[None], metadata=NAMES))
    assert detector.detect(IMAGE).boxes == pytest.approx(np.array([SEEN[0][:4]]), abs=0.01)


@pytest.mark.parametrize('order', ['x1 y1 x2 y2', 'y1 x1 y2 x2'])
def test_corners_of_specks_are_no_centres_although_these_are_as_near_to_the_cells(tmp_path, order):
    rng = np.random.default_rng(3)
    cells = yolo_models.grid(SIDE)
    middles, sides = (cells[:, :2] + rng.normal(0.65, 0.4, (len(cells), 2))) * cells[:, 2:], 0.25 * cells[:, 2:]
    boxes = np.concatenate([middles - 0.5 * sides, middles + 0.5 * sides], axis=1)
    boxes[40] = SEEN[0][:4]
    scores = rng.uniform(0.0, 0.01, (len(cells), 3))
    scores[40, 1] = 0.9
    table = np.concatenate([orders(boxes)[order], scores], axis=1)
    detector = Detector(yolo_models.write(tmp_path / 'model.onnx', output=table.T[None], metadata=NAMES))
    assert detector.detect(IMAGE).boxes == pytest.approx(np.array([SEEN[0][:4]]), abs=0.01)


def test_boxes_outside_the_picture_tell_x_from_y(tmp_path):
    """Of a network that answers the same to all, in pictures whose shape is not that of the input."""
    seen = ((350.0, 20.0, 390.0, 60.0, 1, 0.9), (300.0, 40.0, 340.0, 100.0, 0, 0.6))
    boxes, labels, scores = table(seen=seen)
    output = columns(orders(boxes)['y1 x1 y2 x2'], scores, labels)
    path = yolo_models.write(tmp_path / 'model.onnx', output=output, metadata=NAMES)
    found = Detector(path).detect(np.zeros((234, 416, 3), np.uint8))
    assert found.boxes == pytest.approx(np.array([row[:4] for row in seen]), abs=0.01)


@pytest.mark.parametrize('order', [(0, 1, 2), (0, 2, 1), (2, 1, 0), (1, 2, 0), (1, 0, 2), (2, 0, 1)])
@pytest.mark.parametrize('form', ['x1 y1 x2 y2', 'cx cy w h'])
def test_one_object_of_the_first_class_is_read_in_any_order(tmp_path, form, order):
    """Of box, score and class, where no other row says anything: a 0 everywhere is the class, not the score."""
    parts = [orders([SEEN[0][:4]])[form], np.array([[0.9]]), np.array([[0.0]])]
    rows = np.zeros((1, 300, 6))
    rows[0, 4] = np.concatenate([parts[k] for k in order], axis=1)
    path = yolo_models.write(tmp_path / 'model.onnx', output=rows, metadata={'names': "['drone', 'bird']"})
    found = Detector(path).detect(IMAGE)
    assert found.boxes == pytest.approx(np.array([SEEN[0][:4]]), abs=0.01)
    assert (found.class_names, found.scores[0]) == (('drone',), pytest.approx(0.9))


@pytest.mark.parametrize(('label', 'name'), [(0, 'drone'), (1, 'bird')])
def test_two_classes_of_centres_in_shares_are_no_column_of_classes(tmp_path, label, name):
    """A hundred rows that say nothing, and one object."""
    rows = np.tile([0.6, 0.4, 0.1, 0.2, 0.0, 0.0], (1, 100, 1))
    rows[0, 5, 4 + label] = 0.9
    path = yolo_models.write(tmp_path / 'model.onnx', output=rows, metadata={'names': "['drone', 'bird']"})
    found = Detector(path).detect(IMAGE)
    assert found.class_names == (name,)
    assert found.boxes == pytest.approx(np.array([[0.55, 0.3, 0.65, 0.5]]) * SIDE, abs=0.01)


@pytest.mark.parametrize('count', [0, 1, 5])
def test_tables_without_a_batch_may_be_empty(tmp_path, count):
    """As YOLOv7's with suppression: number of the image, corners, class and score of what is seen alone."""
    rows = np.tile([0.0, *SEEN[0]], (count, 1))
    found = Detector(yolo_models.write(tmp_path / 'model.onnx', output=rows, metadata=NAMES)).detect(IMAGE)
    assert found.boxes == pytest.approx(np.array([SEEN[0][:4]] * min(count, 1)).reshape(-1, 4), abs=0.01)


@pytest.mark.parametrize(('classes', 'names'), [(1, "['drone']"), (2, "['bird', 'drone']"), (80, '')])
def test_detr_with_any_number_of_classes(tmp_path, classes, names):
    boxes, labels, scores = table(1)
    label = min(1, classes - 1)
    output = columns(centred(boxes) / SIDE, by_class(np.where(scores > 0.5, label, labels % classes), scores, classes))
    path = yolo_models.write(tmp_path / 'model.onnx', output=output, metadata={'names': names} if names else {})
    found = Detector(path).detect(IMAGE)
    assert len(found) == 2
    assert found.boxes[0] == pytest.approx(SEEN[0][:4], abs=0.01)


@pytest.mark.parametrize(('change', 'reason'), [
    (lambda boxes, labels, scores: columns(centred(boxes) / SIDE, 8.0 * by_class(labels, scores) - 6.0), 'no logits'),
    (lambda boxes, labels, scores: columns(boxes, 100.0 * scores, labels),
     r'\(1, 100, 6\) go from 2.* to 90, 0 to 2: expected'),
    (lambda boxes, labels, scores: columns(boxes[:, ::-1], scores, labels), 'expected x1, y1, x2, y2 in pixels'),
    (lambda boxes, labels, scores: np.full((1, 100, 6), np.nan), 'of finite numbers')])
def test_what_is_no_table_of_boxes_is_refused_with_what_was_seen(tmp_path, change, reason):
    path = yolo_models.write(tmp_path / 'model.onnx', output=change(*table()), metadata=NAMES)
    with pytest.raises(ModelError, match=reason) as error:
        Detector(path)
    assert str(path) in str(error.value) and '\n' not in str(error.value)


def test_boxes_of_cells_may_be_in_shares_or_turned(tmp_path):
    output = yolo_models.rows_of('v8', SIDE, 3)
    shares = np.concatenate([output[:4] / SIDE, output[4:]])
    for number, changed in enumerate((shares, output.T)):
        found = Detector(yolo_models.write(tmp_path / f'{number}.onnx', output=changed[None], metadata=NAMES)).detect(IMAGE)
        assert found.class_names == ('drone', 'bird')
        assert found.boxes[0] == pytest.approx(yolo_models.TRUTH[0][:4], abs=0.01)


@pytest.mark.parametrize('layout', ['yolox', 'v8', 'v5'])
def test_logits_of_cells_are_refused(tmp_path, layout):
    output = yolo_models.rows_of(layout, SIDE, 3)
    scores = output[4:] if layout == 'v8' else output[:, 4:]
    scores[:] = np.log(np.maximum(scores, 1e-4) / (1.0 - np.minimum(scores, 0.999)))
    with pytest.raises(ModelError, match=r'scores go from -9\.\d+ to .*logits'):
        Detector(yolo_models.write(tmp_path / 'model.onnx', layout, output=output[None], metadata=NAMES))


def write_with_contents(path, output):
    """A model that answers `output` to bright images, and zeros to the grey one by which it is opened."""
    nodes = [helper.make_node('ReduceMean', ['images'], ['mean'], keepdims=0),
             helper.make_node('Greater', ['mean', 'bright'], ['is']),
             helper.make_node('Where', ['is', 'answer', 'nothing'], ['output'])]
    values = [numpy_helper.from_array(np.array(value, np.float32), name) for name, value in
              (('bright', 0.8), ('answer', output), ('nothing', np.zeros_like(output)))]
    images = helper.make_tensor_value_info('images', TensorProto.FLOAT, [1, 3, SIDE, SIDE])
    answer = helper.make_tensor_value_info('output', TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, 'contents', [images], [answer], values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 17)], ir_version=8)
    helper.set_model_props(model, NAMES)
    onnx.save(model, str(path))
    return path


def test_a_model_that_sees_nothing_at_first_is_read_by_its_first_boxes(tmp_path):
    detector = Detector(write_with_contents(tmp_path / 'model.onnx', exports()['corners in shares']))
    assert len(detector.detect(IMAGE)) == 0
    found = detector.detect(np.full_like(IMAGE, 250))
    assert found.boxes[0] == pytest.approx(SEEN[0][:4], abs=0.01) and found.class_names == ('drone', 'bird')


@pytest.mark.parametrize('score', [np.inf, 1.7, -0.4])
def test_no_score_beyond_one_leaves_the_detector(tmp_path, score):
    boxes, labels, scores = table()
    scores[7] = score
    detector = Detector(write_with_contents(tmp_path / 'model.onnx', columns(boxes, scores, labels)))
    cells = yolo_models.rows_of('v8', SIDE, 3)
    cells[4, 40] = score
    by_cell = Detector(write_with_contents(tmp_path / 'cells.onnx', cells[None]))
    if np.isinf(score):    # an overflow of one box
        assert detector.detect(np.full_like(IMAGE, 250)).class_names == ('bird',)
        assert by_cell.detect(np.full_like(IMAGE, 250)).scores.max() < 1.0
        return
    with pytest.raises(ModelError, match='columns of the output'):
        detector.detect(np.full_like(IMAGE, 250))
    with pytest.raises(ModelError, match='scores go from'):
        by_cell.detect(np.full_like(IMAGE, 250))


@pytest.mark.parametrize('shift', [0.0, 1.0])
def test_an_object_is_one_detection(tmp_path, shift):
    """As two classes, or twice with a jitter of a pixel: also 8 pixels wide, of an export that leaves suppression to others."""
    for size in (8.0, 60.0):
        twice = ((100.0, 50.0, 100.0 + size, 50.0 + size, 1, 0.8),
                 (100.0 + shift, 50.0, 100.0 + size + shift, 50.0 + size, 2, 0.7))
        boxes, labels, scores = table(seen=twice)
        path = yolo_models.write(tmp_path / 'model.onnx', output=columns(boxes, scores, labels), metadata=NAMES)
        assert Detector(path).detect(IMAGE).class_names == ('drone',)
        assert len(Detector(path, DetectorSettings(rename={'kite': 'drone'}, keep=('drone',))).detect(IMAGE)) == 1


def test_an_order_that_is_contradicted_takes_no_other_with_it():
    """y before x was the best of three in a first image; a second one contradicts it, and has a box beside the picture."""
    layout, size = Layout(readings(6), is_table=True), (384, 640)
    of_three = np.array([[258, 2, 638, 382, 0.9, 0], [2, 258, 382, 638, 0.9, 0], [256, 2, 382, 382, 0.9, 0]], np.float32)
    layout.settle(np.array([[2, 2, 382, 382, 0.9, 0]], np.float32), size, size, lambda: of_three)
    beside = np.array([[200, 100, 500, 130, 0.9, 0]], np.float32)
    layout.settle(beside, size, (384.0, 100.0), lambda: of_three)
    assert layout.decode(beside, size, 0.5)[0].tolist() == [[200.0, 100.0, 500.0, 130.0]]


def test_the_export_of_the_field(capsys):
    folder = Path(__file__).resolve().parents[4] / 'shared/data/field_cases/exports'
    if not folder.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    assert detect.main([str(folder / 'grey.png'), '--model', str(folder / 'rtdetr_2.onnx'), '--csv']) == 0
    row, = capsys.readouterr().out.splitlines()[1:]
    assert row.startswith('0,0.0,drone,0.9,140.0,90.0,40.0,20.0')
