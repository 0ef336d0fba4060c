"""Images of any depth as 8-bit colour."""

import numpy as np
import pytest

from av_vision.image import to_bgr8

COLOUR = np.random.default_rng(0).integers(0, 256, (7, 11, 3), np.uint8)


def test_any_depth_becomes_8_bit_colour():
    ramp = np.linspace(1000, 3000, 64 * 64).reshape(64, 64).astype(np.uint16)
    grey = to_bgr8(ramp)
    assert grey.shape == (64, 64, 3)
    assert grey.min() == 0
    assert grey.max() == 255
    assert np.array_equal(to_bgr8(COLOUR[..., :1])[..., 2], COLOUR[..., 0])
    for nothing in (np.empty((0, 4, 3), np.uint8), np.zeros(5, np.uint8), np.zeros((4, 4, 2), np.uint8)):
        with pytest.raises(ValueError, match='no image'):
            to_bgr8(nothing)
