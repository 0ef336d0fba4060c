"""Bytes and samples, by hand."""

import numpy as np
import pytest

from av_audio import pcm


def test_known_bytes():
    np.testing.assert_allclose(pcm.decode(b'\x00\x40\x00\xc0', 'S16LE', 2), [[0.5, -0.5]])
    np.testing.assert_allclose(pcm.decode(b'\x00\x00\x80\x3f', 'F32LE', 1), [[1.0]])
    assert pcm.encode(np.array([[0.5, -2.0]]), 'S16LE') == b'\x00\x40\x00\x80'


@pytest.mark.parametrize('sample_format', pcm.FORMATS)
def test_there_and_back(sample_format):
    samples = np.random.default_rng(0).uniform(-1.0, 0.999, (50, 3)).astype(np.float32)
    np.testing.assert_allclose(pcm.decode(pcm.encode(samples, sample_format), sample_format, 3), samples, atol=2.0**-15)


def test_what_does_not_fit_is_named():
    with pytest.raises(ValueError, match='3 bytes'):
        pcm.decode(b'abc', 'S16LE', 1)
    with pytest.raises(ValueError, match="'MP3'"):
        pcm.decode(b'', 'MP3', 1)
