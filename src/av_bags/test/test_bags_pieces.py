import sys
from pathlib import Path

import bag_messages as make
import cv2
import numpy as np
import pytest

from av_bags.reader import Bag
from av_bags.topics import find_topics
from av_bags.writer import BagWriter
from av_evaluation.replay.replay import Replay, ReplaySettings

sys.path.append(str(Path(__file__).parents[2] / 'av_vision' / 'test'))


def test_topics_are_found_by_name_namespace_ending_or_not(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        for topic in ('/a/doa', '/b/doa', '/a/odometry'):
            message = make.odometry(0.0) if 'odometry' in topic else make.doa(0.0, 0.1)
            write(topic, 0.0, message)
    with Bag(tmp_path / 'bag') as bag:
        found = find_topics(bag, ('doa', 'odometry', 'truth/rig'))
        assert found.topics == {'odometry': '/a/odometry'}
        assert 'more than one topic could be doa: /a/doa, /b/doa' in found.missing['doa']
        assert found.missing['truth/rig'] == 'no topic truth/rig (by its type /a/odometry could be it: truth/rig:=/a/odometry)'
        assert find_topics(bag, ('doa',), namespace='b').topics == {'doa': '/b/doa'}
        assert find_topics(bag, ('doa',), {'doa': '/a/doa'}).topics == {'doa': '/a/doa'}


def picture(kind):
    rows, columns = np.mgrid[0:48, 0:64]
    colour = np.stack([rows * 4, columns * 3, rows + columns], -1).astype(np.uint8)
    pictures = {'bgr8': colour, 'rgb8': colour[..., ::-1], 'mono8': colour[..., 0],
                'bgra8': np.dstack([colour, colour[..., :1]]), '16UC1': colour[..., 0].astype(np.uint16) * 200,
                'bayer_rggb8': colour[..., 0], 'yuv422_yuy2': colour[..., :2]}
    if kind in ('jpeg', 'png'):
        data = cv2.imencode(f'.{kind}', colour)[1].ravel()
        return make.make('sensor_msgs/msg/CompressedImage', make.header(make.EPOCH, 'camera_optical_frame'), kind, data)
    pixels = np.ascontiguousarray(pictures[kind])
    return make.make('sensor_msgs/msg/Image', make.header(make.EPOCH, 'camera_optical_frame'), 48, 64, kind, 0,
                     pixels.nbytes // 48, pixels.view(np.uint8).ravel())


@pytest.mark.parametrize('kind', ['bgr8', 'rgb8', 'mono8', 'bgra8', '16UC1', 'bayer_rggb8', 'yuv422_yuy2', 'jpeg', 'png'])
def test_pictures_of_any_encoding_are_looked_at(tmp_path, kind):
    yolo_models = pytest.importorskip('yolo_models')
    model = yolo_models.write(tmp_path / 'model.onnx', metadata={'names': "{0: 'cat', 1: 'drone', 2: 'bird'}"})
    with make.bag(tmp_path / 'bag') as write:
        for _ in range(3):
            write('/eye/image', make.EPOCH, picture(kind))
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
    settings = ReplaySettings(stage='raw', model=str(model), remappings={'camera/image_raw': '/eye/image'})
    with Bag(tmp_path / 'bag') as bag, BagWriter(tmp_path / 'out.mcap') as out:
        Replay(bag, settings).run(out)
    with Bag(tmp_path / 'out.mcap') as bag:
        seen = [bag.decode(topic, data) for topic, _, data in bag.messages(['/detections'])]
    assert len(seen) == 3
    assert {d.results[0].hypothesis.class_id for message in seen for d in message.detections} == {'drone'}
    assert seen[0].header.frame_id == 'camera_optical_frame'


def test_a_picture_that_is_none_is_left_out_and_noted(tmp_path):
    yolo_models = pytest.importorskip('yolo_models')
    model = yolo_models.write(tmp_path / 'model.onnx', metadata={'names': "{0: 'cat', 1: 'drone', 2: 'bird'}"})
    with make.bag(tmp_path / 'bag') as write:
        broken = picture('jpeg')
        broken.data = broken.data[:20]
        write('/camera/image_raw/compressed', make.EPOCH, broken)
        write('/camera/image_raw/compressed', make.EPOCH, picture('jpeg'))
    with Bag(tmp_path / 'bag') as bag:
        replay = Replay(bag, ReplaySettings(stage='raw', model=str(model)))
        replay.run()
    assert len(replay.log.sight) == 1
    assert any('/camera/image_raw/compressed: 20 bytes of compressed image cannot be decoded' in note for note in replay.notes)
