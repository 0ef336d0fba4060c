"""Bytes and samples, by hand."""

import numpy as np
import pytest

from av_bags.converters import decode


def test_known_bytes():
    np.testing.assert_allclose(decode(b'\x00\x40\x00\xc0', 'S16LE', 2), [[0.5, -0.5]])
    np.testing.assert_allclose(decode(b'\x00\x00\x00\x40', 'S32LE', 1), [[0.5]])
    np.testing.assert_allclose(decode(b'\x00\x00\x80\x3f', 'F32LE', 1), [[1.0]])


def test_what_does_not_fit_is_named():
    with pytest.raises(ValueError, match='3 bytes'):
        decode(b'abc', 'S16LE', 1)
    with pytest.raises(ValueError, match="'MP3'"):
        decode(b'', 'MP3', 1)
