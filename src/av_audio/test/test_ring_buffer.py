"""The ring buffer against a plain list of what was written."""

import threading

import numpy as np
import pytest

from av_audio import RingBuffer


def ramp(start, stop, channels=2):
    return np.repeat(np.arange(start, stop, dtype=np.float32)[:, None], channels, axis=1) + np.arange(channels)


def test_reads_what_was_written_across_the_seam():
    buffer = RingBuffer(2, capacity_bytes=100 * 2 * 4)
    expected = 0
    for start in range(0, 700, 70):
        buffer.write(ramp(start, start + 70))
        first, samples = buffer.read()
        assert first == expected
        np.testing.assert_array_equal(samples, ramp(start, start + 70))
        expected += 70
    assert buffer.overwritten == 0
    assert buffer.read()[1].shape == (0, 2)


def test_overwrites_the_oldest_and_counts():
    buffer = RingBuffer(2, capacity_bytes=100 * 2 * 4)
    buffer.write(ramp(0, 80))
    buffer.write(ramp(80, 150))
    first, samples = buffer.read()
    assert (first, len(samples), buffer.overwritten) == (50, 100, 50)
    np.testing.assert_array_equal(samples, ramp(50, 150))


def test_a_block_longer_than_the_buffer_keeps_its_end():
    buffer = RingBuffer(1, capacity_bytes=40)
    buffer.write(ramp(0, 25, 1))
    first, samples = buffer.read()
    assert first == 15
    np.testing.assert_array_equal(samples, ramp(15, 25, 1))


def test_a_gap_of_the_source_ends_a_block():
    buffer = RingBuffer(2)
    buffer.write(ramp(0, 10), first_sample=1000)
    buffer.write(ramp(10, 20), first_sample=1010)
    buffer.write(ramp(50, 60), first_sample=1050)
    first, samples = buffer.read()
    assert (first, len(samples)) == (1000, 20)
    first, samples = buffer.read(4)
    assert (first, len(samples)) == (1050, 4)
    assert buffer.read()[0] == 1054


def test_never_exceeds_its_bytes():
    assert RingBuffer(2).capacity * 2 * 4 <= 200_000
    with pytest.raises(ValueError, match='capacity_bytes=7'):
        RingBuffer(2, capacity_bytes=7)
    with pytest.raises(ValueError, match=r'expected \(n, 2\)'):
        RingBuffer(2).write(np.zeros((5, 3)))


def test_threads_lose_nothing_uncounted():
    """Each sample holds its own index, so that a torn or misplaced block would show."""
    buffer = RingBuffer(2, capacity_bytes=5000 * 8)
    total = 400_000

    def write():
        for start in range(0, total, 500):
            buffer.write(ramp(start, start + 500))

    writer = threading.Thread(target=write)
    writer.start()
    seen = 0
    while writer.is_alive() or buffer.available:
        buffer.wait(0.01)
        first, samples = buffer.read()
        seen += len(samples)
        np.testing.assert_array_equal(samples, ramp(first, first + len(samples)))
    writer.join()
    assert seen + buffer.overwritten == total
