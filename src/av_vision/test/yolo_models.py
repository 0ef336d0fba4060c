"""Tiny ONNX models with the outputs of the known YOLO exports, made of constants: what they see is known exactly."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

CELLS = {416: 3549, 640: 8400}
# x1, y1, x2, y2 in pixels of the input, class, score
TRUTH = ((96.0, 160.0, 160.0, 200.0, 1, 0.9), (300.0, 40.0, 340.0, 100.0, 0, 0.6))


def grid(side):
    rows = []
    for stride in (8, 16, 32):
        for y in range(side // stride):
            rows += [(x, y, stride) for x in range(side // stride)]
    return np.array(rows, float)


def rows_of(layout, side, classes, truth=TRUTH):
    """The output (a, b) of an export that sees `truth` and, around it, near-duplicates and doubtful background."""
    cells = grid(side)
    count = {'v5': 3 * len(cells), 'end_to_end': 300}.get(layout, len(cells))
    table = np.zeros((count, 5 + classes))
    if layout in ('yolox', 'v8', 'v5'):
        table[:, :2] = np.resize((cells[:, :2] + 0.5) * cells[:, 2:], (count, 2))
        table[:, 2:4] = np.resize(cells[:, 2:] * 3.0, (count, 2))
    table[:, 4] = 0.01
    for k, (x1, y1, x2, y2, label, score) in enumerate(truth):
        cx, cy, w, h = (x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1
        for copy in range(2):  # the second is a duplicate for NMS to take out
            row = 40 + 7 * k + copy
            table[row] = [cx + 2 * copy, cy, w, h, 0.95, *(score * (1 - 0.1 * copy) / 0.95 * np.eye(classes)[label])]
            if layout == 'yolox_raw':
                x, y, stride = cells[row]
                table[row, :4] = [cx / stride - x + 2 * copy / stride, cy / stride - y, np.log(w / stride), np.log(h / stride)]
    if layout == 'v8':
        return np.concatenate([table[:, :4], table[:, 5:] * table[:, 4:5]], 1).T
    if layout == 'end_to_end':
        out = np.zeros((300, 6))
        for k, box in enumerate(truth):
            out[k] = [*box[:4], box[5], box[4]]
        return out
    return table


def write(path, layout='v8', side=416, classes=3, metadata=None, half=False, dynamic=False, output=None, heads=0):
    """Write a model that answers `output` (or what `layout` would) to every image, and raw heads after it; returns the path."""
    kind, tensor = (np.float16, TensorProto.FLOAT16) if half else (np.float32, TensorProto.FLOAT)
    answer = rows_of(layout, side, classes)[None] if output is None else output
    shape = ['batch', 3, 'height', 'width'] if dynamic else [1, 3, side, side]
    nodes = [helper.make_node('ReduceMean', ['images'], ['mean'], keepdims=0),
             helper.make_node('Mul', ['mean', 'zero'], ['nothing']), helper.make_node('Add', ['answer', 'nothing'], ['output'])]
    values = [numpy_helper.from_array(answer.astype(kind), 'answer'), numpy_helper.from_array(np.array(0, kind), 'zero')]
    raw = [f'head{k}' for k in range(heads)]
    nodes += [helper.make_node('Identity', ['nothing'], [name]) for name in raw]
    graph = helper.make_graph(nodes, 'constant', [helper.make_tensor_value_info('images', tensor, shape)],
                              [helper.make_tensor_value_info(name, tensor, None) for name in ('output', *raw)], values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 17)], ir_version=8)
    helper.set_model_props(model, metadata or {})
    onnx.save(model, str(path))
    return path


def write_means(path, side=416, dynamic=False, half=False):
    """Write a model whose one box has the mean of each channel of its input as scores; returns the path."""
    kind, tensor = (np.float16, TensorProto.FLOAT16) if half else (np.float32, TensorProto.FLOAT)
    shape = ['batch', 3, 'height', 'width'] if dynamic else [1, 3, side, side]
    nodes = [helper.make_node('ReduceMean', ['images'], ['mean'], axes=[2, 3], keepdims=0),
             helper.make_node('Unsqueeze', ['mean', 'last'], ['scores']),
             helper.make_node('Concat', ['box', 'scores'], ['one'], axis=1), helper.make_node('Mul', ['one', 'at'], ['output'])]
    at = np.zeros((1, 1, len(grid(side))))
    at[..., 1300] = 1.0
    values = [numpy_helper.from_array(np.array([[[60.0], [200.0], [20.0], [20.0]]], kind), 'box'),
              numpy_helper.from_array(at.astype(kind), 'at'), numpy_helper.from_array(np.array([2]), 'last')]
    graph = helper.make_graph(nodes, 'means', [helper.make_tensor_value_info('images', tensor, shape)],
                              [helper.make_tensor_value_info('output', tensor, None)], values)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid('', 17)], ir_version=8), str(path))
    return path
