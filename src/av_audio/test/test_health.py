"""Faults made on purpose, one at a time."""

from types import SimpleNamespace

import numpy as np
import pytest
from known_sound import RATE, flat

from av_audio.health import ChannelHealth, SwapDetector
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.microphone_array import MicrophoneArray


def noise(level=0.1):
    return level * np.random.default_rng(1).normal(size=(4800, 2)).astype(np.float32)


@pytest.mark.parametrize('spoil, words', [
    (lambda x: np.clip(30.0 * x, -1.0, 1.0), 'channel 0 clips'),
    (lambda x: x * np.float32([1.0, 0.0]), 'channel 1 is dead'),
    (lambda x: x * np.float32([1.0, 0.003]), 'channel 1 is 50 dB quieter'),
    (lambda x: x + np.float32([0.0, 0.2]), 'channel 1 has a constant offset of +0.20'),
    (lambda x: x[:, [0, 0]], 'channels 0, 1 are identical'),
])
def test_a_fault_is_named_until_it_is_mended(spoil, words):
    health = ChannelHealth(2)
    health.update(spoil(noise()))
    assert any(words in problem for problem in health.problems())
    health.update(noise())
    assert health.problems() == []


def test_levels_are_those_of_the_channels():
    health = ChannelHealth(2)
    health.update(noise(0.1) * np.float32([1.0, 0.1]))
    np.testing.assert_allclose(health.levels_dbfs(), [-20.0, -40.0], atol=0.5)


def test_a_sudden_swap_is_noticed_and_a_moving_source_is_not():
    pair = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
    sound = flat(np.random.default_rng(2), 4.0, np.array([0.0, 3e-4]))
    sound = sound / np.abs(sound).max()
    swapped = np.concatenate([sound[:RATE * 2], sound[RATE * 2:, ::-1]])
    for stream, expected in [(sound, 0), (swapped, 1)]:
        detector = SwapDetector()
        localizer = Localizer(pair, RATE, LocalizerSettings(hop_s=0.1))
        assert sum(detector.update(estimate) for estimate in localizer.process(stream, 0)) == expected
    detector = SwapDetector()
    localizer = Localizer(pair, RATE, LocalizerSettings(hop_s=0.5))
    for k, delay in enumerate(np.linspace(-5e-4, 5e-4, 20)):
        window = flat(np.random.default_rng(k), 0.5, np.array([0.0, delay]))
        estimate, = localizer.process(window / np.abs(window).max(), localizer.next_sample)
        assert not detector.update(estimate)


def test_a_rig_that_turns_past_the_source_is_no_swap():
    detector = SwapDetector()
    for k, azimuth in enumerate(np.radians(np.clip(np.arange(-60.0, 90.0, 6.0), -40.0, 40.0))):    # 60 degrees a second
        assert not detector.update(SimpleNamespace(time=0.1 * k, confidence=np.array([1.0]), q=np.sin([azimuth])))
