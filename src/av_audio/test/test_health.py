"""Faults made on purpose, one at a time."""

import math

import numpy as np
import pytest
from flying_rig import RING, FlyingRig, coloured
from known_sound import PAIR, RATE, SQUARE, add_noise, rotors

from av_audio import ChannelHealth
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

C = speed_of_sound(20.0)


SECONDS = 3.0


def hear(sound, array=PAIR, rate=RATE):
    """The faults that are told of a sound (n, m) at any time."""
    health, told = ChannelHealth(sound.shape[1], rate, array), set()
    for block in np.array_split(sound.astype(np.float32), 60):
        health.update(block)
        told |= {fault.text for fault in health.faults}
    return told


def drone(array, azimuth=0.7, snr_db=15.0, seed=1, seconds=SECONDS):
    """Rotors far away, and noise of each microphone."""
    rng, delays = np.random.default_rng(seed), -array.positions @ angles_to_direction(azimuth, 0.2) / C
    return add_noise(rng, rotors(rng, seconds, delays - delays.min()), snr_db) / 4.0


def with_channel(sound, number, other):
    return np.concatenate([sound[:, :number], other[:, None], sound[:, number + 1:]], axis=1)


def late(sound, seconds):
    return np.roll(sound, round(seconds * RATE))


TRIANGLE = MicrophoneArray(0.1 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.87, 0.0], [-0.5, -0.87, 0.0]]))
TETRAHEDRON = MicrophoneArray(0.05 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]))
WHITE = np.random.default_rng(9).normal(size=round(SECONDS * RATE))
FAULTS = {
    'dead': (lambda x: 0.0 * x, 'is dead'), 'unplugged': (lambda x: 3e-4 * WHITE, 'hears nothing'),
    'quiet': (lambda x: 0.12 * x, 'dB quieter'), 'inverted': (lambda x: -x, 'inverted'),
    'late': (lambda x: late(x, 2.3e-3), 'is late by'), 'clipping': (lambda x: np.clip(2.0 * x, -0.16, 0.16), 'clips'),
    'offset': (lambda x: x + 0.2, 'offset of +0.20')}


@pytest.mark.parametrize('array', [PAIR, SQUARE, RING], ids=['pair', 'square', 'ring'])
def test_a_fault_of_a_channel_is_named(array):
    sound, number = drone(array, azimuth=-0.5), array.channels // 2
    for name, (spoil, words) in FAULTS.items():
        told = hear(with_channel(sound, number, spoil(sound[:, number])), array)
        of_which = 'channel 0 or 1 ' if words == 'inverted' and array is PAIR else f'channel {number} '
        assert told and all(words in text and of_which in text for text in told), (name, told)


@pytest.mark.parametrize('array', [TRIANGLE, SQUARE, TETRAHEDRON, RING], ids=['triangle', 'square', 'tetrahedron', 'ring'])
def test_a_channel_that_hisses_as_loud_as_others_hear_is_named_and_left_out(array):
    """Two of three microphones tell a cone; the place on it was that where noise agreed best, with confidence."""
    sound = drone(array, azimuth=-0.5)
    health = ChannelHealth(array.channels, RATE, array)
    health.update(with_channel(sound, 1, sound.std() * WHITE))
    assert [fault.text for fault in health.faults] == ['channel 1 hears nothing of what others hear']
    assert health.usable == [k for k in range(array.channels) if k != 1]


@pytest.mark.parametrize('steps', [0.3, 0.6, 2.0, 5.0, 30.0])
def test_quiet_sound_of_few_steps_of_the_converter_does_not_clip(steps):
    """Standard deviation in such steps."""
    sound = drone(PAIR, snr_db=5.0)
    sound *= steps / sound.std()
    assert not hear(np.round(sound) * 2.0**-15)


@pytest.mark.parametrize('rate', [8000, 11_025, 16_000])
def test_noise_of_few_samples_a_window_does_not_clip(rate):
    health, noise = ChannelHealth(2, rate), np.random.default_rng(4).normal(size=(100 * rate, 2))
    for second in np.split(0.05 * noise, 100):
        health.update(second)
        assert not health.faults


def test_a_click_in_quiet_sound_does_not_clip():
    quiet = 1e-2 * drone(PAIR)
    quiet[5000] = 0.8
    assert not hear(quiet)


@pytest.mark.parametrize('gain', [1.0, 0.3])
def test_one_microphone_in_two_channels_is_named(gain):
    sound = drone(SQUARE)
    copied = np.round(with_channel(sound, 3, gain * sound[:, 1]) * 2**15) / 2**15
    assert hear(copied, SQUARE) == {'channels 1, 3 are identical: one microphone, not an array'}


@pytest.mark.parametrize('scale', [1e12, 1e18, 1e30])
def test_samples_without_measure_are_no_error(scale):
    """Of a decoder that took something else for floating point."""
    sound = drone(PAIR)
    hear(with_channel(sound, 1, scale * sound[:, 1]))


def test_a_fault_is_told_until_it_is_mended():
    sound = drone(PAIR)
    health = ChannelHealth(2, RATE, PAIR)
    health.update(with_channel(sound, 1, -sound[:, 1]))
    (fault,) = health.faults
    assert fault.is_severe and fault.mend in str(fault)
    health.update(drone(PAIR, seed=2))
    assert not health.faults


def healthy(array):
    """Sounds (n, m) of microphones that are all right, by name."""
    rng, count = np.random.default_rng(3), round(SECONDS * RATE)
    hiss = 1e-4 * rng.normal(size=(count, array.channels))
    wind = coloured(rng, hiss.shape, 7.0 / 6.0, 2.0)
    wind *= 0.1 / wind.std()
    one_side = wind * np.where(np.arange(array.channels) == 0, 1.0, 0.003)
    distances = np.linalg.norm(array.positions - 0.3 * angles_to_direction(1.57, 0.0), axis=1)
    near = rotors(rng, SECONDS, distances / C) / distances
    time = np.arange(count)[:, None] / RATE + array.positions @ angles_to_direction(1.5, 0.0) / C
    return {
        'end-fire': drone(array, 1.57), 'faint': drone(array, -1.2, -8.0), 'wind': wind + 0.1 * drone(array),
        'wind at one': one_side + 0.1 * drone(array), 'wind at one alone': one_side + hiss, 'a quiet room': hiss,
        'near one microphone': 0.05 * near / near.std() + hiss,
        'tones': 0.05 * sum(np.sin(math.tau * k * 171.0 * time + k * k) / k for k in range(1, 30)) + hiss,
        'a whistle': 0.2 * np.sin(math.tau * 1730.0 * time) + hiss,
        'a loud tone': 0.99 * np.sin(math.tau * 211.0 * time) + hiss,
        'unequal gains': drone(array, 2.5) * 10.0 ** (np.linspace(-3.0, 3.0, array.channels) / 20.0)}


@pytest.mark.parametrize('array', [PAIR, RING], ids=['pair', 'ring'])
def test_microphones_that_are_all_right_are_not_blamed(array):
    assert {name: told for name, sound in healthy(array).items() if (told := hear(sound, array))} == {}


@pytest.mark.parametrize('azimuth', [-2.6, 0.4, 1.9])
@pytest.mark.parametrize(('array', 'pair', 'named'), [
    (SQUARE, (0, 1), '0 and 1 or 2 and 3'), (SQUARE, (1, 2), '0 and 3 or 1 and 2'), (RING, (3, 4), '3 and 4'),
    (RING, (0, 5), '0 and 5')])
def test_exchanged_channels_of_an_array_are_named(array, pair, named, azimuth):
    """Of a square two sides are exchanged with the same effect, but for a mirror image."""
    sound = drone(array, azimuth)
    sound[:, pair] = sound[:, pair[::-1]]
    assert hear(sound, array) == {f'channels {named} are exchanged'}


def test_two_drones_are_no_exchanged_channels():
    assert hear(drone(RING, 0.3) + drone(RING, 2.1, seed=2), RING) == set()


@pytest.mark.parametrize('seed', [1008, 1015, 1020])
def test_own_rotors_are_no_exchanged_channels(seed):
    turns, rng = np.arange(6) * np.pi / 3.0, np.random.default_rng(seed)
    array = MicrophoneArray(0.0463 * np.stack([np.cos(turns), np.sin(turns), np.zeros(6)], axis=1))
    assert hear(0.05 * FlyingRig(array, rng).alone(rng, 6.0)[0], array) == set()


@pytest.mark.parametrize('number', [1, 3])
def test_a_late_channel_is_named_where_only_one_neighbour_tells(number):
    """The corners of a square aside from the source: towards the other neighbour, the delay is that of another direction."""
    sound = drone(SQUARE)
    told = hear(with_channel(sound, number, late(sound[:, number], 0.35e-3)), SQUARE)
    assert told and all(text.startswith(f'channel {number} is late by 0.5 ms') for text in told)
