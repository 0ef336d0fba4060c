"""The detect program on files, with a network whose answers are known."""

import csv
import json

import cv2
import numpy as np
import pytest
import yolo_models

from av_vision.cli import detect


@pytest.fixture
def folder(tmp_path):
    images = tmp_path / 'images'
    images.mkdir()
    for k in range(3):
        cv2.imwrite(str(images / f'{k}.png'), np.full((416, 416, 3), 40 * k, np.uint8))
    yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata={'names': "['bird', 'drone', 'kite']"})
    return tmp_path


def run(folder, capsys, *options):
    code = detect.main([str(folder / 'images'), '--model', str(folder / 'model.onnx'), *options])
    return code, capsys.readouterr()


def test_csv_has_the_promised_columns_and_pixels_of_the_input(folder, capsys):
    code, printed = run(folder, capsys, '--rate', '10')
    rows = list(csv.DictReader(printed.out.splitlines()))
    assert code == 0
    assert list(rows[0]) == ['frame', 'time', 'class', 'score', 'x', 'y', 'w', 'h', 'track']
    assert [row['frame'] for row in rows] == ['0', '1', '2']
    assert [row['time'] for row in rows] == ['0.0', '0.1', '0.2']
    assert {row['track'] for row in rows} == {'1'}
    x1, y1, x2, y2 = yolo_models.TRUTH[0][:4]
    assert [float(rows[0][key]) for key in 'xywh'] == pytest.approx([x1, y1, x2 - x1, y2 - y1])
    assert 'frame 1 of 3' in printed.err


def test_thermal_images_have_their_detector_and_their_gain(folder, capsys, monkeypatch):
    """Raw counts are developed as on a rig, and inverted where heat is dark; the shipped model is the thermal one."""
    (folder / 'raw').mkdir()
    counts = np.random.default_rng(0).normal(7000.0, 100.0, (416, 416)).astype(np.uint16)
    cv2.imwrite(str(folder / 'raw' / '0.png'), counts)
    searched, find = {}, detect.TemporalDetector.detect
    for camera in ('thermal', 'black_hot'):
        monkeypatch.setattr(detect.TemporalDetector, 'detect',
                            lambda self, image, *rest, camera=camera: find(self, searched.setdefault(camera, image), *rest))
        assert detect.main([str(folder / 'raw'), '--camera', camera, '--model', str(folder / 'model.onnx'), '--quiet']) == 0
    assert searched['thermal'].dtype == np.uint8 and np.array_equal(searched['thermal'], 255 - searched['black_hot'])
    assert detect.detector_of(detect.parse(['x', '--camera', 'thermal'])).model.path.name == 'drone_detector_ir.onnx'


def test_json_and_all_classes(folder, capsys):
    code, printed = run(folder, capsys, '--json', '--classes', 'all', '--quiet')
    rows = [json.loads(line) for line in printed.out.splitlines()]
    assert code == 0
    assert [row['class'] for row in rows[:2]] == ['drone', 'bird']
    assert rows[0]['track'] != rows[1]['track']
    assert printed.err == ''


@pytest.mark.parametrize('classes', ['drone,bird', 'drone, bird', ' bird ,drone,'])
def test_classes_are_separated_by_commas_and_spaces(folder, capsys, classes):
    code, printed = run(folder, capsys, '--classes', classes, '--quiet')
    assert code == 0 and {row['class'] for row in csv.DictReader(printed.out.splitlines())} == {'drone'}
    assert len(printed.out.splitlines()) == 1 + 3 * len(yolo_models.TRUTH)


def test_output_file_and_video(folder, capsys):
    out, video = folder / 'rows.csv', folder / 'drawn.mp4'
    code, printed = run(folder, capsys, '--output', str(out), '--save-video', str(video), '--quiet')
    assert (code, printed.out) == (0, '')
    assert len(out.read_text().splitlines()) == 4
    drawn = cv2.VideoCapture(str(video))
    assert drawn.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    green = drawn.read()[1][160, 120].astype(int)
    assert green[1] > green[0] + 50  # the box's upper edge


def test_images_of_other_sizes_are_fitted_into_the_video(folder, capsys):
    cv2.imwrite(str(folder / 'images/1.png'), np.full((300, 900, 3), 200, np.uint8))
    video = folder / 'drawn.mp4'
    code, _ = run(folder, capsys, '--save-video', str(video), '--quiet')
    drawn = cv2.VideoCapture(str(video))
    frames = [drawn.read()[1] for _ in range(3)]
    assert code == 0
    assert [frame.shape for frame in frames] == [(416, 416, 3)] * 3
    assert frames[1][10, 300].mean() == pytest.approx(200, abs=10)
    assert frames[1][400, 300].mean() == pytest.approx(114, abs=10)


@pytest.mark.parametrize(('options', 'reason'), [
    (['nowhere.mp4'], 'nowhere.mp4 does not exist'), (['images', '--model', 'nowhere.onnx'], 'nowhere.onnx does not exist'),
    (['images', '--save-video', '\udcff.mp4'], 'is not UTF-8'),
    (['images', '--model', 'model.onnx', '--classes', 'plane'], "not ['plane']: name those that are drones")])
def test_what_cannot_be_used_is_said_in_one_line(folder, capsys, monkeypatch, options, reason):
    monkeypatch.chdir(folder)
    options = options if '--model' in options else [*options, '--model', 'model.onnx']
    assert detect.main(options) == 2
    assert reason in capsys.readouterr().err


def test_an_empty_image_is_an_error(folder, capsys):
    (folder / 'images/0.png').write_bytes(b'')
    code, printed = run(folder, capsys)
    assert code == 2
    assert '0 bytes' in printed.err
