"""Sound of the rig itself, rendered as spherical waves, against plane waves."""

import numpy as np
import pytest

from av_audio import DOA_METHODS, Direction, Localizer, LocalizerSettings, NoiseRecording
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

RATE, SECONDS = 48_000, 0.5
C = speed_of_sound(20.0)
PAIR = MicrophoneArray(np.array([[0.0, 0.08, 0.0], [0.0, -0.08, 0.0]]))
RING = MicrophoneArray(np.array([[0.1 * np.cos(a), 0.1 * np.sin(a), 0.0] for a in np.arange(6) * np.pi / 3.0]))
# of a hexacopter, which no other test or table has
ROTORS = np.array([[0.28 * np.cos(a), 0.28 * np.sin(a), 0.05] for a in (np.arange(6) + 0.5) * np.pi / 3.0])


def tones(rng, fundamental_hz, delays):
    """Harmonics (n, m) of a rotor whose speed wanders by 1 %, after delays (m,)."""
    time = np.arange(round(SECONDS * RATE))[:, None] / RATE - delays
    turn = fundamental_hz * (time + 0.01 / (2.0 * np.pi * 3.0) * np.sin(2.0 * np.pi * (3.0 * time + rng.uniform())))
    numbers = np.arange(1, int(4000.0 / fundamental_hz))
    return np.sum([np.cos(2.0 * np.pi * (k * turn + rng.uniform())) / np.sqrt(k) for k in numbers], axis=0)


def own(rng, array):
    """Sound (n, m) of own rotors: amplitudes fall with distances."""
    ranges = np.linalg.norm(array.positions - ROTORS[:, None], axis=2)
    return np.sum([tones(rng, rng.uniform(110.0, 160.0), r / C) / r for r in ranges], axis=0)


def target(rng, array, azimuth):
    """Plane wave (n, m) of a drone."""
    return tones(rng, rng.uniform(160.0, 240.0), -array.positions @ angles_to_direction(azimuth) / C)


def window(rng, array, over_db):
    """A target under own sound of a level over the target's, and noise of -20 dB."""
    far, near = target(rng, array, rng.uniform(-np.pi, np.pi)), own(rng, array)
    sound = far / far.std() + 10.0 ** (over_db / 20.0) * near / near.std() + 0.1 * rng.normal(size=far.shape)
    return (0.1 * sound / sound.std()).astype(np.float32)


def own_of(array, sounds, method='ml', recording=None):
    localizer = Localizer(array, RATE, LocalizerSettings(window_s=SECONDS, hop_s=SECONDS, method=method), recording)
    return np.array([localizer.process(sound, localizer.next_sample)[0].own for sound in sounds])


@pytest.mark.parametrize('array', [PAIR, RING], ids=['pair', 'ring'])
def test_own_rotors_that_are_louder_are_told_from_a_target(array):
    rng = np.random.default_rng(4)
    assert np.mean(own_of(array, [window(rng, array, 15.0) for _ in range(20)]) > 0.5) >= 0.9
    assert np.mean(own_of(array, [window(rng, array, -np.inf) for _ in range(20)]) < 0.2) >= 0.9


def test_a_recording_hides_own_rotors_from_no_method_that_does_not_use_it(monkeypatch):
    rng = np.random.default_rng(4)
    alone = NoiseRecording(np.concatenate([own(rng, PAIR) for _ in range(4)]).astype(np.float32), RATE)
    monkeypatch.setattr(DOA_METHODS, 'check', lambda name: None)
    monkeypatch.setattr(DOA_METHODS, 'load', lambda name: lambda array, rate: lambda samples: [Direction(0.3, 0.01)])
    sounds = [window(rng, PAIR, 15.0) for _ in range(10)]
    assert np.array_equal(own_of(PAIR, sounds, 'ahead', alone), own_of(PAIR, sounds, 'ahead'))
    assert np.mean(own_of(PAIR, sounds, 'ahead', alone) > 0.5) >= 0.9


def test_gains_of_microphones_are_no_near_field():
    rng = np.random.default_rng(5)
    sounds = [window(rng, RING, -np.inf) * 10.0 ** (rng.normal(0.0, 2.0, RING.channels) / 20.0) for _ in range(20)]
    assert np.mean(own_of(RING, sounds) < 0.2) >= 0.9


def test_own_sound_takes_the_confidence():
    rng = np.random.default_rng(6)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(window_s=SECONDS, hop_s=SECONDS))
    estimates = [localizer.process(window(rng, PAIR, 20.0), localizer.next_sample)[0] for _ in range(20)]
    assert np.median([estimate.confidence[0] for estimate in estimates]) < 0.3


def test_two_targets_at_opposite_sides_are_afar():
    rng = np.random.default_rng(7)
    both = [target(rng, PAIR, 1.2) + target(rng, PAIR, -1.3) for _ in range(20)]
    both = [(0.1 * (sound + 0.05 * sound.std() * rng.normal(size=sound.shape)) / sound.std()).astype(np.float32)
            for sound in both]
    assert np.mean(own_of(PAIR, both) < 0.2) >= 0.9


@pytest.mark.parametrize('array', [PAIR, RING], ids=['pair', 'ring'])
def test_a_dead_channel_and_notched_bins_give_numbers(array):
    rng = np.random.default_rng(8)
    sound = window(rng, array, 0.0)
    sound[:, 1] = 0.0
    localizer = Localizer(array, RATE, LocalizerSettings(window_s=SECONDS, hop_s=SECONDS))
    localizer.blade_pass_hz = np.array([120.0, 131.0])
    with np.errstate(all='raise', under='ignore'):
        assert 0.0 <= localizer.process(sound, 0)[0].own <= 1.0
