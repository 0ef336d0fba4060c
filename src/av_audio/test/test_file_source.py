"""A file as a source in real time."""

import time

import numpy as np
import pytest
import soundfile

from av_audio.file_source import FileSource, read_sound
from av_audio.ring_buffer import RingBuffer


@pytest.fixture
def ramp_file(tmp_path):
    path = tmp_path / 'ramp.wav'
    samples = np.stack([np.arange(4000) / 8000.0, -np.arange(4000) / 8000.0, np.zeros(4000)], axis=1)
    soundfile.write(path, samples, 16_000, subtype='FLOAT')
    return path, samples.astype(np.float32)


def collect(source, frames):
    buffer = RingBuffer(source.channels, 10_000_000)  # a reader that stalls for minutes loses nothing
    source.start(buffer)
    blocks = []
    while sum(map(len, blocks)) < frames and not (source.finished and not buffer.available):
        buffer.wait(0.1)
        blocks.append(buffer.read()[1])
    source.stop()
    return np.concatenate(blocks)


def test_a_file_arrives_whole_and_in_order(ramp_file):
    path, samples = ramp_file
    source = FileSource(path, channels=[1, 0], block_samples=160)
    np.testing.assert_array_equal(collect(source, 4000), samples[:, [1, 0]])
    assert source.sample_rate == 16_000
    assert source.finished


def test_a_loop_has_no_gap(ramp_file):
    path, samples = ramp_file
    received = collect(FileSource(path, block_samples=1500, loop=True), 9000)
    np.testing.assert_array_equal(received[:9000], np.tile(samples, (3, 1))[:9000])


def test_a_block_does_not_come_before_it_has_sounded(ramp_file):
    source = FileSource(ramp_file[0], block_samples=1600)
    buffer = RingBuffer(3)
    begin = time.monotonic()
    source.start(buffer)
    while not buffer.available:
        buffer.wait(1.0)
    assert time.monotonic() - begin >= 0.1
    source.stop()
    assert source.time_of(1600) - source.time_of(0) == pytest.approx(0.1)


def test_bad_files_say_what_is_wrong(tmp_path, ramp_file):
    with pytest.raises(FileNotFoundError, match='does not exist'):
        FileSource(tmp_path / 'missing.wav')
    (tmp_path / 'text.wav').write_text('no sound')
    with pytest.raises(OSError, match=r'text\.wav'):
        FileSource(tmp_path / 'text.wav')
    with pytest.raises(ValueError, match=r'channels 0\.\.2, not \[3\]'):
        FileSource(ramp_file[0], channels=[0, 3])
    with pytest.raises(ValueError, match='channels'):
        read_sound(ramp_file[0], [-1])


def test_a_player_that_is_late_joins_in(ramp_file):
    """What should have sounded before is left out, by whole blocks; stamps and indices are those of one that was in time."""
    path, samples = ramp_file
    source, buffer = FileSource(path, block_samples=400, now=lambda: 100.0), RingBuffer(3)
    source.start(buffer, begin=99.93)    # 1120 samples ago
    while not buffer.available:
        buffer.wait(1.0)
    first, block = buffer.read(400)
    source.stop()
    assert first == 800 and source.time_of(first) == pytest.approx(99.98)
    np.testing.assert_array_equal(block, samples[800:1200])


def test_a_player_that_is_early_waits(ramp_file):
    source, buffer = FileSource(ramp_file[0], block_samples=160, now=lambda: 100.0), RingBuffer(3)
    before = time.monotonic()
    source.start(buffer, begin=100.2)
    buffer.wait(5.0)
    source.stop()
    assert time.monotonic() - before >= 0.2 and source.time_of(0) == 100.2
