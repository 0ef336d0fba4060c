"""The thermal model that ships, on real clips that it was not trained on: white-hot, black-hot, and as raw counts."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip('av_vision.nodes.detector_node_parameters', reason='needs the workspace to be built')

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from av_common.parameters import node_parameters
from av_vision.messages import detections_from_message, image_message
from av_vision.models import shipped_model
from av_vision.stage import make_detection_stage

CLIPS = Path(__file__).resolve().parents[4] / 'shared/data/drone_detection'
DRONES = ('IR_DRONE_020', 'IR_DRONE_079', 'IR_DRONE_118', 'IR_DRONE_139')  # one of each place
OTHERS = ('IR_BIRD_040', 'IR_BIRD_058', 'IR_AIRPLANE_059', 'IR_HELICOPTER_020')
STEP = 6  # frames between two images

pytestmark = pytest.mark.skipif(not (CLIPS / 'video_ir').exists(), reason=f'{CLIPS}/video_ir is not here')


def white_hot(grey, number):
    return image_message(header(number), grey)


def black_hot(grey, number):
    return image_message(header(number), 255 - grey)


def raw(grey, number):
    noise = np.random.default_rng(number).normal(0.0, 4.0, grey.shape)
    return image_message(header(number), (7000.0 + 5.0 * grey + noise).astype(np.uint16), 'mono16')


def header(number):
    return Header(stamp=Time(sec=100 + number // 30, nanosec=number % 30 * 33_333_333), frame_id='thermal_optical_frame')


def thermal_stage():
    settings = {'camera_kind': 'thermal', 'threads': 1}
    return make_detection_stage(node_parameters('av_vision', 'detector_node', overrides=settings))


def judged(clip, message_of):
    """Of every sixth frame of a clip, as the rig sees it: drones labelled, of these found, and false boxes."""
    labels = np.genfromtxt(CLIPS / 'labels_ir' / f'{clip}.csv', delimiter=',', skip_header=1, usecols=(0, 2, 3, 4, 5))
    stage = thermal_stage()
    video, number, rows = cv2.VideoCapture(str(CLIPS / 'video_ir' / f'{clip}.mp4')), 0, []
    while video.grab():
        if number % STEP == 0:
            grey = cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2GRAY)
            message, visibility = stage.on_image(message_of(grey, number), 0.0)
            assert visibility is None
            boxes = detections_from_message(message)[0].boxes
            real = labels[labels[:, 0] == number, 1:] if 'DRONE' in clip else labels[:0, 1:]
            real = np.concatenate([real[:, :2], real[:, :2] + real[:, 2:]], axis=1)
            shared = (np.minimum(boxes[:, None, 2:], real[None, :, 2:]) - np.maximum(boxes[:, None, :2], real[None, :, :2]))
            shared = shared.clip(0).prod(-1)
            area = [(each[:, 2:] - each[:, :2]).prod(-1) for each in (boxes, real)]
            hit = shared / (area[0][:, None] + area[1][None] - shared) >= 0.3
            rows.append((len(real), hit.any(axis=0).sum(), (~hit.any(axis=1)).sum()))
        number += 1
    return np.array(rows)


def test_the_model_says_what_it_is():
    stage = thermal_stage()
    model = stage.detector.detector.model
    assert model.path == shipped_model('thermal') and model.path.stat().st_size < 5e6
    assert model.class_names == ('drone', 'bird', 'airplane', 'helicopter') and model.metadata['license'] == 'Apache-2.0'
    assert json.loads(model.metadata['score_fusion'])['memory_s'] > 1.0


@pytest.mark.parametrize('message_of', [white_hot, black_hot, raw])
def test_drones_of_clips_never_seen_are_found(message_of):
    rows = np.concatenate([judged(clip, message_of) for clip in DRONES])
    labelled, found, false = rows.sum(axis=0)
    assert labelled > 80
    assert 2 * found / (labelled + found + false) > 0.85  # F1


def test_birds_airplanes_and_helicopters_are_no_drones():
    rows = np.concatenate([judged(clip, white_hot) for clip in OTHERS])
    assert len(rows) > 100 and np.mean(rows[:, 2] > 0) < 0.05
