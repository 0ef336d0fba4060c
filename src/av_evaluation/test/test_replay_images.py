import sys
from pathlib import Path

import bag_messages as make
import pytest

from av_bags.reader import Bag
from av_bags.writer import BagWriter
from av_evaluation.replay.replay import Replay, ReplaySettings

sys.path.append(str(Path(__file__).parents[2] / 'av_vision' / 'test'))


@pytest.mark.parametrize('kind', ['bgr8', 'rgb8', 'mono8', 'bgra8', '16UC1', 'bayer_rggb8', 'yuv422_yuy2', 'jpeg', 'png'])
def test_images_of_any_encoding_are_searched(tmp_path, kind):
    yolo_models = pytest.importorskip('yolo_models')
    model = yolo_models.write(tmp_path / 'model.onnx', metadata={'names': "{0: 'cat', 1: 'drone', 2: 'bird'}"})
    with make.bag(tmp_path / 'bag') as write:
        for _ in range(3):
            write('/eye/image', make.EPOCH, make.image(kind))
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
    settings = ReplaySettings(stage='raw', model=str(model), remappings={'camera/image_raw': '/eye/image'})
    with Bag(tmp_path / 'bag') as bag, BagWriter(tmp_path / 'out.mcap') as out:
        Replay(bag, settings).run(out)
    with Bag(tmp_path / 'out.mcap') as bag:
        seen = [bag.decode(topic, data) for topic, _, data in bag.messages(['/detections'])]
    assert len(seen) == 3
    assert {d.results[0].hypothesis.class_id for message in seen for d in message.detections} == {'drone'}
    assert seen[0].header.frame_id == 'camera_optical_frame'


def test_an_image_that_is_none_is_left_out_and_noted(tmp_path):
    yolo_models = pytest.importorskip('yolo_models')
    model = yolo_models.write(tmp_path / 'model.onnx', metadata={'names': "{0: 'cat', 1: 'drone', 2: 'bird'}"})
    with make.bag(tmp_path / 'bag') as write:
        broken = make.image('jpeg')
        broken.data = broken.data[:20]
        write('/camera/image_raw/compressed', make.EPOCH, broken)
        write('/camera/image_raw/compressed', make.EPOCH, make.image('jpeg'))
    with Bag(tmp_path / 'bag') as bag:
        replay = Replay(bag, ReplaySettings(stage='raw', model=str(model)))
        replay.run()
    assert len(replay.log.sight) == 1
    assert any('/camera/image_raw/compressed: image of 20 bytes cannot be decoded' in note for note in replay.notes)
