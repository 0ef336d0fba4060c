"""A real network on real images."""

from pathlib import Path

import cv2
import pytest

from av_vision import Detector, DetectorSettings

DATA = Path(__file__).resolve().parents[4] / 'shared/data'
MODEL, CLIP = DATA / 'models/yolox_nano_coco.onnx', DATA / 'drone_detection/video/V_DRONE_001.mp4'

pytestmark = pytest.mark.skipif(not MODEL.exists(), reason=f'{MODEL} is not here')


@pytest.fixture(scope='module')
def detector():
    return Detector(MODEL, DetectorSettings(keep=('drone',), rename=dict.fromkeys(('airplane', 'bird', 'kite'), 'drone')))


def test_undecoded_yolox_finds_a_real_drone(detector):
    video = cv2.VideoCapture(str(CLIP))
    found = detector.detect(video.read()[1])
    # The clip's first label: 124.93, 22.94, 75.85 x 39.20, loose.
    assert found.class_names == ('drone',)
    assert found.centres[0] == pytest.approx([162.9, 42.5], abs=8.0)


def test_grey_images_work_too(detector):
    video = cv2.VideoCapture(str(CLIP))
    grey = cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2GRAY)
    assert len(detector.detect(grey)) >= 1
    assert len(detector.detect(grey.astype('uint16') * 200)) >= 1
