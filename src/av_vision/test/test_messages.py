"""Messages against OpenCV, by round trips, and with fields that contradict each other."""

from array import array
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip('av_interfaces.msg', reason='needs the workspace to be built')

from sensor_msgs.msg import Image
from std_msgs.msg import Header

from av_common.camera import PinholeCamera
from av_vision import Detections, camera_info_message, detections_message, image_from_message, image_message

RNG = np.random.default_rng(0)
HEADER = Header(frame_id='camera_optical_frame')
HEADER.stamp.sec, HEADER.stamp.nanosec = 12, 500
COLOUR = RNG.integers(0, 256, (7, 11, 3), np.uint8)


def message(image, encoding, padding=0, bigendian=False):
    rows = np.ascontiguousarray(image).view(np.uint8).reshape(image.shape[0], -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    return SimpleNamespace(height=image.shape[0], width=image.shape[1], encoding=encoding, step=rows.shape[1],
                           is_bigendian=bigendian, data=array('B', rows.tobytes()))


@pytest.mark.parametrize('padding', [0, 5])
def test_colours_come_out_as_bgr(padding):
    alpha = np.dstack([COLOUR, np.full((7, 11), 255, np.uint8)])
    sent = [(COLOUR, 'bgr8'), (COLOUR[..., ::-1], 'rgb8'), (alpha, 'bgra8'), (alpha[..., [2, 1, 0, 3]], 'rgba8')]
    for image, encoding in sent:
        assert np.array_equal(image_from_message(message(image, encoding, padding)), COLOUR), encoding


def test_grey_16_bit_and_depth_keep_their_numbers():
    deep = RNG.integers(0, 65536, (7, 11)).astype(np.uint16)
    assert np.array_equal(image_from_message(message(deep, '16UC1')), deep)
    assert np.array_equal(image_from_message(message(deep.astype('>u2'), 'mono16', bigendian=True)), deep)
    assert np.array_equal(image_from_message(message(COLOUR[..., 0], 'mono8', 3)), COLOUR[..., 0])
    metres = RNG.random((7, 11)).astype(np.float32)
    assert np.array_equal(image_from_message(message(metres, '32FC1', 4)), metres)


def test_cameras_of_more_than_8_bits_send_colours_and_mosaics_of_them():
    deep = RNG.integers(0, 65536, (7, 11, 3)).astype(np.uint16)
    assert np.array_equal(image_from_message(message(deep[..., ::-1].astype('>u2'), 'rgb16', 4, bigendian=True)), deep)
    mosaic = RNG.integers(0, 256, (8, 12), np.uint8)
    for pattern in ('rggb', 'bggr', 'gbrg', 'grbg'):
        coarse, fine = (image_from_message(message(counts, f'bayer_{pattern}{8 * counts.itemsize}'))
                        for counts in (mosaic, mosaic.astype(np.uint16)))
        assert fine.dtype == np.uint16 and np.array_equal(coarse, fine), pattern


@pytest.mark.parametrize('image', [COLOUR, COLOUR[..., 0], np.arange(12, dtype=np.uint16).reshape(3, 4),
                                   COLOUR.astype(np.uint16), COLOUR.astype(np.float32)])
def test_round_trip(image):
    sent = image_message(HEADER, image)
    assert isinstance(sent, Image)
    assert isinstance(sent.data, array)
    assert sent.header == HEADER
    assert np.array_equal(image_from_message(sent), image)


def test_compressed():
    good, data = cv2.imencode('.png', COLOUR)
    assert good
    assert np.array_equal(image_from_message(SimpleNamespace(format='png', data=array('B', data.tobytes()))), COLOUR)
    for junk in (b'', b'junk', data.tobytes()[:20]):
        with pytest.raises(ValueError, match='cannot be decoded'):
            image_from_message(SimpleNamespace(format='jpeg', data=array('B', junk)))


def test_messages_that_lie_are_refused():
    short = message(COLOUR, 'bgr8')
    short.data = short.data[:-1]
    with pytest.raises(ValueError, match='11x7 bgr8'):
        image_from_message(short)
    with pytest.raises(ValueError, match='pink9'):
        image_from_message(message(COLOUR, 'pink9'))
    empty = message(COLOUR, 'bgr8')
    empty.width = 0
    with pytest.raises(ValueError, match='0x7'):
        image_from_message(empty)


def test_an_image_of_another_type_than_its_encoding_is_refused():
    with pytest.raises(ValueError, match='is not 16UC1'):
        image_message(HEADER, COLOUR, '16UC1')
    with pytest.raises(ValueError, match='has no encoding'):
        image_message(HEADER, COLOUR.astype(np.float64))


@pytest.mark.parametrize('distortion, model', [
    ((), 'plumb_bob'), ((0.1, -0.2, 0.001, 0.002, 0.03), 'plumb_bob'), ((), 'equidistant'),
    ((0.1, -0.2, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4), 'rational_polynomial'), ((0.1, -0.02, 0.01, 0.003), 'equidistant')])
def test_a_camera_comes_back_from_its_message(distortion, model):
    camera = PinholeCamera(640, 480, 500.0, 510.0, 320.5, 240.5, distortion, model == 'equidistant')
    info = camera_info_message(HEADER, camera)
    assert info.header == HEADER
    assert info.distortion_model == model
    assert np.reshape(info.p, (3, 4))[:, :3] == pytest.approx(camera.matrix)
    assert PinholeCamera.from_camera_info(info) == camera


def test_detections_are_in_their_message():
    detections = Detections(np.array([[1.0, 2.0, 5.0, 10.0], [0.0, 0.0, 2.5, 1.0]]), np.array([0.9, 0.4]), ('drone', 'bird'))
    message = detections_message(HEADER, detections, (7, 'oracle'))
    assert {tuple(map(str, (one.header.stamp, one.header.frame_id))) for one in message.detections} == {
        (str(HEADER.stamp), HEADER.frame_id)}
    boxes = [one.bbox for one in message.detections]
    assert [(box.center.position.x, box.center.position.y, box.size_x, box.size_y) for box in boxes] == [
        (3, 6, 4, 8), (1.25, 0.5, 2.5, 1.0)]
    assert [one.results[0].hypothesis.score for one in message.detections] == [0.9, 0.4]
    assert [(one.results[0].hypothesis.class_id, one.id) for one in message.detections] == [('drone', '7'), ('bird', 'oracle')]


def test_no_detection_is_an_empty_array():
    message = detections_message(HEADER, Detections(), ())
    assert len(message.detections) == 0
