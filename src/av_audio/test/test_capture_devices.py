"""Capture on a real path: a player, PulseAudio, ALSA, PortAudio, our buffer."""

import time

import numpy as np
import pytest
import soundfile
from pulse import PulseCard

from av_audio.benchmark.signals import RATE, flat
from av_audio.device_process import load_sounddevice
from av_audio.device_source import DeviceSource
from av_audio.localizer import Localizer
from av_audio.ring_buffer import RingBuffer
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
    card = PulseCard(tmp_path)
    card.plug()
    yield card
    card.unplug()


@pytest.fixture
def source(card):
    """A started source with its buffer, stopped whatever happens."""
    source = DeviceSource('', RATE)
    buffer = RingBuffer(2)
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
    """Blocks (first sample, samples, stamp) that arrive within some time of the first."""
    source, buffer = started
    wait_until(lambda: buffer.available)
    blocks = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        buffer.wait(0.1)
        while buffer.available:
            first, samples = buffer.read(1600)
            blocks.append((first, samples, source.time_of(first)))
    return blocks


def wait_until(condition):
    """Time for slow machines; fails when it does not come true."""
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_the_direction_of_played_sound_is_found_and_stamps_are_regular(card, source, sound_file):
    card.play(sound_file)
    wait_until(lambda: source[1].available)
    begin = time.time()
    blocks = capture(source, 6.0)
    localizer = Localizer(PAIR, RATE)
    estimates = [estimate for first, samples, _ in blocks for estimate in localizer.process(samples, first)]
    azimuths = [np.degrees(estimate.azimuth[0]) for estimate in estimates[-20:]]
    np.testing.assert_allclose(azimuths, 40.0, atol=1.0)
    assert np.mean([estimate.confidence[0] > 0.9 for estimate in estimates[-20:]]) == 1.0
    firsts = np.array([first for first, _, _ in blocks])
    stamps = np.array([stamp for _, _, stamp in blocks])
    elapsed = np.diff(firsts) / RATE
    assert np.abs(np.diff(stamps) - elapsed).max() < 1e-4
    assert begin - 1.0 < stamps[0] < begin + 2.0
    assert source[0].overflows == 0


def test_unplugging_is_survived(card, source, sound_file):
    before = capture(source, 1.0)
    card.unplug()
    wait_until(lambda: source[0].lost)
    card.plug()
    wait_until(lambda: not source[0].lost)
    after = capture(source, 1.0)
    assert source[0].reopened >= 1
    gap = after[-1][0] - before[-1][0]
    away = after[-1][2] - before[-1][2]
    assert gap / RATE == pytest.approx(away, abs=0.3)


def test_what_a_device_cannot_do_is_said_with_what_it_can(card):
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
