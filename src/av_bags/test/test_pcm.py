"""PCM samples of other packages against values written out by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from av_bags.converters import AudioBytes, AudioLayout
from av_bags.definitions import BagError


@pytest.mark.parametrize(('data', 'sample_format', 'samples'), [
    (b'\x00\x40\x00\xc0', 'S16LE', [0.5, -0.5]), (b'\x00\x00\x00\x40\x00\x00\x00\xc0', 'S32LE', [0.5, -0.5]),
    (b'\x00\x00\x80\x3f\x00\x00\x80\xbf', 'F32LE', [1.0, -1.0])])
def test_full_scale_is_one_and_a_sample_may_come_in_two_parts(data, sample_format, samples):
    convert = AudioBytes(AudioLayout(48_000, 2, sample_format))
    assert not convert(SimpleNamespace(data=list(data[:3])), 10**9)
    (frame,) = convert(SimpleNamespace(data=list(data[3:])), 10**9)
    np.testing.assert_allclose(frame.samples, samples)


def test_layouts_are_refused():
    with pytest.raises(BagError, match="'MP3', expected one of S16LE"):
        AudioLayout(48_000, 1, 'MP3')
