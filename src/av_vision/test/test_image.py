"""Conversion of image messages, against OpenCV and by round trips."""

from array import array
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from av_vision.image import encoding_of, fill_message, image_from_message, to_bgr8

RNG = np.random.default_rng(0)
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


@pytest.mark.parametrize('image', [COLOUR, COLOUR[..., 0], np.arange(12, dtype=np.uint16).reshape(3, 4)])
def test_round_trip(image):
    sent = fill_message(SimpleNamespace(), image, encoding_of(image))
    assert isinstance(sent.data, array)
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


def test_anything_can_be_looked_at():
    ramp = np.linspace(1000, 3000, 64 * 64).reshape(64, 64).astype(np.uint16)
    grey = to_bgr8(ramp)
    assert grey.shape == (64, 64, 3)
    assert grey.min() == 0
    assert grey.max() == 255
    assert np.array_equal(to_bgr8(COLOUR[..., :1])[..., 2], COLOUR[..., 0])
    for nothing in (np.empty((0, 4, 3), np.uint8), np.zeros(5, np.uint8), np.zeros((4, 4, 2), np.uint8)):
        with pytest.raises(ValueError, match='no image'):
            to_bgr8(nothing)
