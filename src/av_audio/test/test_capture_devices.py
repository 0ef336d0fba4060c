"""Capture on a real path: a player, PulseAudio, ALSA, PortAudio, our buffer."""

import time

import numpy as np
import pytest
import soundfile
from known_sound import RATE, flat
from pulse import PulseCard

from av_audio import DeviceSource, Localizer, RingBuffer, device_source
from av_audio.device_process import load_sounddevice
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray

PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])


def missing():
    """What has to be installed for these tests, '' when nothing."""
    try:
        load_sounddevice()
    except ImportError as error:
        return str(error)
    return PulseCard.missing()


pytestmark = pytest.mark.skipif(bool(missing()), reason=f'not installed: {missing()}')


@pytest.fixture
def card(tmp_path, monkeypatch):
    for name in ('PULSE_SERVER', 'PULSE_RUNTIME_PATH', 'PULSE_STATE_PATH', 'ALSA_CONFIG_PATH', 'HOME'):
        monkeypatch.setenv(name, '')  # to be restored afterwards
    monkeypatch.setattr(device_source, 'OPEN_WITHIN_S', 120.0)  # a busy machine starts processes slowly
    card = PulseCard(tmp_path)
    card.plug()
    yield card
    card.unplug()


@pytest.fixture
def source(card):
    """A started source with its buffer, stopped whatever happens."""
    source = DeviceSource('', RATE)
    buffer = RingBuffer(2, 50_000_000)  # a reader that stalls for minutes loses nothing
    source.opened = time.time()
    source.start(buffer)
    yield source, buffer
    source.stop()


@pytest.fixture
def sound_file(tmp_path):
    """Twenty seconds of sound from 40 degrees."""
    delay = PAIR.aperture * np.sin(np.radians(40.0)) / speed_of_sound(20.0)
    sound = flat(np.random.default_rng(5), 20.0, np.array([0.0, delay]))
    path = tmp_path / 'from_40_degrees.wav'
    soundfile.write(path, 0.3 * sound / np.abs(sound).max(), RATE)
    return path


def capture(started, seconds):
    """Blocks (first sample, samples, stamp) of at least this much sound in s."""
    source, buffer = started
    blocks = []
    while sum(len(samples) for _, samples, _ in blocks) < seconds * RATE:
        wait_until(lambda: buffer.available)
        while buffer.available:
            first, samples = buffer.read(1600)
            blocks.append((first, samples, source.time_of(first)))
    return blocks


def wait_until(condition):
    """Wait for an event; the limit only determines how long a failure takes."""
    end = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_the_direction_of_played_sound_is_found_and_stamps_are_regular(card, source, sound_file):
    card.play(sound_file)
    localizer, blocks, estimates = Localizer(PAIR, RATE), [], []
    while len(estimates) < 40:  # the player may take its time before there is sound
        blocks += (new := capture(source, 0.5))
        estimates += [estimate for first, samples, _ in new for estimate in localizer.process(samples, first)
                      if len(estimate.azimuth)]
        assert len(blocks) < 5000
    read = time.time()
    azimuths = [np.degrees(estimate.azimuth[0]) for estimate in estimates[-20:]]
    np.testing.assert_allclose(azimuths, 40.0, atol=1.0)
    assert np.mean([estimate.confidence[0] > 0.9 for estimate in estimates[-20:]]) == 1.0
    firsts = np.array([first for first, _, _ in blocks])
    stamps = np.array([stamp for _, _, stamp in blocks])
    # a machine that stalls may lose samples, which is counted, or deliver the first blocks late, to which times are slewed
    irregular = np.abs(np.diff(stamps) - np.diff(firsts) / RATE)
    assert np.count_nonzero(irregular > 0.02 * np.diff(firsts) / RATE + 1e-4) <= source[0].clock.restarts
    assert np.median(irregular) < 1e-4
    gaps = np.diff(firsts) - [len(samples) for _, samples, _ in blocks[:-1]]
    assert np.count_nonzero(gaps) <= source[0].overflows + source[0].reopened
    assert source[0].opened < stamps[0] <= stamps[-1] < read


def test_unplugging_is_survived(card, source, sound_file):
    before = capture(source, 1.0)
    card.unplug()
    unplugged = time.time()
    wait_until(lambda: source[0].lost)
    plugged = time.time()
    card.plug()
    wait_until(lambda: not source[0].lost)
    after = capture(source, 1.0)
    assert source[0].reopened >= 1
    index, stamp = ((after[-1][k] - before[-1][k]) / (RATE if k == 0 else 1) for k in (0, 2))
    for away in (index, stamp):  # by both the gap lasts at least as long as nothing could be captured
        assert plugged - unplugged < away < time.time() - before[-1][2]


def test_a_refused_device_is_described(card):
    def start(*arguments):
        DeviceSource(*arguments).start(RingBuffer(2))

    with pytest.raises(ValueError, match=r"device='no such thing' matches 0 capture devices; devices: .*\d+: "):
        start('no such thing', RATE)
    with pytest.raises(ValueError, match=r'device=9999 is not a capture device; devices: .*\d+: '):
        start('9999', RATE)
    with pytest.raises(ValueError, match=r'channels 0\.\.\d+, not \[4000\]'):
        start('default', RATE, [0, 4000])
    with pytest.raises(ValueError, match=r'sample_rate=7; with 2 channels it can do \[8000, .*48000'):
        start('default', 7)
