"""A file as a source in real time."""

import io
import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import soundfile

from av_audio import FileSource, RingBuffer, read_sound


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


@pytest.mark.parametrize('late_s', [1e9, 3.15e8 + 0.07])
def test_a_loop_that_is_years_late_joins_in_at_once(ramp_file, late_s):
    """As one that is started again after the clock was set."""
    path, samples = ramp_file
    source, buffer = FileSource(path, block_samples=400, loop=True, now=lambda: late_s), RingBuffer(3)
    source.start(buffer, begin=0.0)
    assert buffer.wait(5.0)
    first, block = buffer.read(400)
    source.close()
    np.testing.assert_array_equal(block, np.roll(samples, -(first % len(samples)), axis=0)[:len(block)])


def test_a_loop_of_a_file_that_breaks_off_goes_on(tmp_path):
    content, _ = written('FLAC', seconds=1.0)
    (tmp_path / 'cut.flac').write_bytes(content[:len(content) // 2])
    present = read_sound(tmp_path / 'cut.flac')[0]
    heard = collect(FileSource(tmp_path / 'cut.flac', block_samples=800, loop=True), 2 * len(present))
    np.testing.assert_array_equal(heard[:2 * len(present)], np.tile(present, (2, 1)))


def test_a_player_that_is_early_waits(ramp_file):
    source, buffer = FileSource(ramp_file[0], block_samples=160, now=lambda: 100.0), RingBuffer(3)
    before = time.monotonic()
    source.start(buffer, begin=100.2)
    buffer.wait(5.0)
    source.stop()
    assert time.monotonic() - before >= 0.2 and source.time_of(0) == 100.2


def chunk(name, content, size=None):
    return name + struct.pack('<I', len(content) if size is None else size) + content


def written(file_format, subtype='PCM_16', seconds=1.0):
    """The bytes of a file of two channels, and its samples."""
    samples = 0.1 * np.random.default_rng(0).normal(size=(round(16_000 * seconds), 2))
    buffer = io.BytesIO()
    soundfile.write(buffer, samples, 16_000, format=file_format, subtype=subtype)
    return bytearray(buffer.getvalue()), samples


@pytest.mark.parametrize(('rate', 'channels'), [(44_100, 2), (48_000, 1), (48_000, 4)])
def test_a_loop_ends_where_its_file_is_replaced_by_one_of_other_sound(tmp_path, rate, channels):
    """At the rate of the former one its tones, and with them all delays, would be others."""
    path = tmp_path / 'sound.wav'
    soundfile.write(path, np.full((4800, 2), 0.25), 48_000)
    source, buffer = FileSource(path, block_samples=480, loop=True), RingBuffer(2)
    soundfile.write(tmp_path / 'new.wav', np.full((4800, channels), 0.75), rate)
    source.start(buffer)
    assert buffer.wait(10.0)
    (tmp_path / 'new.wav').replace(path)
    deadline = time.monotonic() + 20.0
    while not source.finished and time.monotonic() < deadline:
        time.sleep(0.02)
    source.close()
    assert source.finished and np.all(buffer.read()[1] == 0.25)


@pytest.mark.parametrize('subtype', ['PCM_16', 'PCM_24', 'FLOAT'])
@pytest.mark.parametrize('size', [0, 4000, 2**32 - 1])
@pytest.mark.parametrize('kind', ['WAV', 'WAVEX'])
def test_a_killed_recorder_leaves_the_samples_that_are_there(tmp_path, kind, subtype, size):
    """Its header knows of no samples, of those at its last update, or of as many as possible."""
    content, samples = written(kind, subtype)
    at = content.find(b'data') + 4
    content[at:at + 4] = struct.pack('<I', size)
    content[4:8] = struct.pack('<I', size)
    (tmp_path / 'killed.wav').write_bytes(content)
    read, rate = read_sound(tmp_path / 'killed.wav')
    assert rate == 16_000
    np.testing.assert_allclose(read, samples, atol=1e-4)
    source = FileSource(tmp_path / 'killed.wav', block_samples=800)
    np.testing.assert_allclose(collect(source, 16_000), samples, atol=1e-4)


def test_a_killed_recorder_of_large_files(tmp_path):
    content, samples = written('RF64')
    content[20:28] = content[28:36] = bytes(8)
    (tmp_path / 'killed.wav').write_bytes(content)
    np.testing.assert_allclose(read_sound(tmp_path / 'killed.wav')[0], samples, atol=1e-4)


def test_a_header_that_breaks_off_is_refused(tmp_path):
    """As of a disk that was full at once."""
    for kind in ('WAV', 'RF64'):
        content, _ = written(kind)
        for size in range(44):
            (tmp_path / 'cut.wav').write_bytes(content[:size])
            with pytest.raises((OSError, ValueError), match=r'cut\.wav'):
                read_sound(tmp_path / 'cut.wav')


def test_what_follows_the_samples_is_no_sound(tmp_path):
    content, samples = written('WAV')
    content += chunk(b'LIST', b'INFO' + chunk(b'ICMT', b'over the field')) + chunk(b'cue ', bytes(28))
    content[4:8] = struct.pack('<I', len(content) - 8)
    (tmp_path / 'whole.wav').write_bytes(content)
    np.testing.assert_allclose(read_sound(tmp_path / 'whole.wav')[0], samples, atol=1e-4)


def test_a_compressed_file_is_read_up_to_where_it_breaks_off(tmp_path):
    content, samples = written('FLAC', seconds=10.0)
    (tmp_path / 'cut.flac').write_bytes(content[:len(content) // 2])
    read, _ = read_sound(tmp_path / 'cut.flac')
    assert 48_000 < len(read) < 80_000
    np.testing.assert_allclose(read, samples[:len(read)], atol=1e-4)
    assert len(collect(FileSource(tmp_path / 'cut.flac', block_samples=48_000), 32_000)) >= 32_000


def test_a_stream_whose_header_states_no_length_is_read_to_its_last_sample(tmp_path):
    """As encoders write it into a pipe; 21 and the next four bytes of a FLAC are the number of samples."""
    content, samples = written('FLAC', seconds=1.3)
    content[21] &= 0xF0
    content[22:26] = bytes(4)
    (tmp_path / 'stream.flac').write_bytes(content)
    np.testing.assert_allclose(read_sound(tmp_path / 'stream.flac')[0], samples, atol=1e-4)
    source = FileSource(tmp_path / 'stream.flac', block_samples=1600)
    for _ in range(2):  # it can be started again after its end
        np.testing.assert_allclose(collect(source, len(samples)), samples, atol=1e-4)
    source.close()
    source, buffer = FileSource(tmp_path / 'stream.flac', block_samples=1600, loop=True, now=lambda: 100.0), RingBuffer(2)
    source.start(buffer, begin=91.0)  # in the seventh repetition
    buffer.wait(5.0)
    first, block = buffer.read(1600)
    source.close()
    np.testing.assert_allclose(block, np.roll(samples, -(first % len(samples)), axis=0)[:len(block)], atol=1e-4)


@pytest.mark.parametrize(('kind', 'subtype'), [('WAV', 'FLOAT'), ('FLAC', 'PCM_16'), ('OGG', 'VORBIS'), ('stream', 'PCM_16')])
def test_a_loop_ends_where_its_file_is_truncated(tmp_path, kind, subtype):
    """Or gone with its disk: the player says that it has ended, and can be stopped."""
    content, _ = written('FLAC' if kind == 'stream' else kind, subtype, seconds=0.3)
    if kind == 'stream':    # whose header states no length
        content[21] &= 0xF0
        content[22:26] = bytes(4)
    path = tmp_path / 'sound'
    path.write_bytes(content)
    source, buffer = FileSource(path, block_samples=160, loop=True), RingBuffer(2)
    source.start(buffer)
    assert buffer.wait(10.0)
    os.truncate(path, 44)
    end = time.monotonic() + 10.0
    while not source.finished and time.monotonic() < end:
        time.sleep(0.01)
    assert source.finished
    source.close()


def test_the_killed_recorder_of_the_field():
    path = Path(__file__).resolve().parents[4] / 'shared/data/field_cases/sound'
    if not path.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    np.testing.assert_array_equal(read_sound(path / 'stream_zero.wav')[0], read_sound(path / 'plain16.wav')[0])
