"""What DeviceSource makes of the blocks of its capturing process, with a clock that is known."""

import numpy as np

from av_audio.device_process import HEADER
from av_audio.device_source import DeviceSource
from av_audio.ring_buffer import RingBuffer

RATE, BLOCK = 48_000, 1600


class Capture:
    """A source that is fed by hand, as its thread would."""

    def __init__(self):
        self.now = 1000.0
        self.source = DeviceSource('', RATE, now=lambda: self.now)
        self.source._buffer = self.buffer = RingBuffer(2)

    def take(self, overflowed=False, later=0.0):
        """A block that was captured right after the one before, or so much later in s; the index of its first sample."""
        self.now += BLOCK / RATE + later
        self.source._take(HEADER.pack(BLOCK / RATE, overflowed) + np.full((BLOCK, 2), 0.25, np.float32).tobytes())
        first, samples = self.buffer.read()
        assert len(samples) in (0, BLOCK)
        return first


def test_overflows_are_counted_and_what_was_lost_is_a_gap():
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    assert np.all(np.diff(firsts[20:]) == BLOCK)
    after = capture.take(overflowed=True, later=0.1)
    assert capture.source.overflows == 1
    assert abs(after - firsts[-1] - BLOCK - 0.1 * RATE) < 0.002 * RATE
    assert capture.take() == after + BLOCK
    assert abs(capture.source.time_of(after) - (capture.now - 2 * BLOCK / RATE)) < 2e-3


def test_an_overflow_that_lost_nothing_leaves_no_gap():
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    assert capture.take(overflowed=True) == firsts[-1] + BLOCK
    assert capture.source.overflows == 1


def test_a_block_that_only_comes_late_is_no_gap():
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    assert capture.take(later=0.3) == firsts[-1] + BLOCK
    assert capture.source.overflows == 0
