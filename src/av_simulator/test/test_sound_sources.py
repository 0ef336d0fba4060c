"""What moving sources do to their sound: manoeuvres, directivity, several at once, and the microphones' clock."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from av_common.config_reader import read
from av_simulator.sound import (
    Ground,
    Medium,
    Noise,
    ReverbZone,
    RotorDirectivity,
    RotorSignal,
    SoundWorld,
    Source,
    Surroundings,
    ToneSignal,
    load_profile,
)

RATE = 48000
PROFILES = Path(__file__).parents[3] / 'config' / 'drones'


def at(place):
    return lambda times: np.broadcast_to(np.asarray(place, float), (len(times), 3))


def hear(sources, seconds=1.0, **world):
    still = np.zeros((2, 1, 3))
    return SoundWorld(RATE, sources, microphones=1, noise=Noise(None), **world).render(int(seconds * RATE), still)[:, 0]


def frequency_of(samples):
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 16 * len(samples)))
    return np.argmax(spectrum) * RATE / (16 * len(samples))


def test_pitch_follows_the_thrust_of_a_turn():
    def circling(t):  # 1 g sideways: sqrt(2) of the weight
        return np.stack([10.0 * np.cos(t), 10.0 * np.sin(t), 0 * t + 10.0], axis=1)

    signal = RotorSignal(rotor_hz=(100.0,), blades=2, jitter=0.0, broadband_db_spl=-100.0)
    heard = hear([Source(circling, signal)])
    assert frequency_of(heard[RATE // 4:]) == pytest.approx(200.0 * ((10.0 / 9.80665) ** 2 + 1.0) ** 0.25, abs=1.0)


def test_several_sources_add():
    sources = [Source(at([5.0, 0, 0]), ToneSignal(500.0)), Source(at([0, 9.0, 0]), ToneSignal(900.0), gain_db=-6.0)]
    both = hear(sources)
    np.testing.assert_allclose(both, hear(sources[:1]) + hear(sources[1:]), atol=1e-7)


def test_directivity_weighs_the_direction_of_emission():
    rotors = RotorDirectivity(tone_axis_db=-20.0)
    above, beside, bare = (hear([Source(at(place), ToneSignal(50.0), directivity=weight)])[RATE // 4:].std()
                           for place, weight in (([0, 0, 10.0], rotors), ([0, 10.0, 0], rotors), ([0, 10.0, 0], None)))
    assert beside == pytest.approx(bare, rel=1e-2)
    assert above == pytest.approx(bare / 10, rel=1e-2)


def test_rotors_send_tones_sideways_and_hiss_down():
    directivity = RotorDirectivity(tone_axis_db=-10.0, noise_side_db=-5.0)
    factors = directivity(np.array([[0, 0, -1.0], [1.0, 0, 0]]), np.array([50.0, 8000.0]))
    np.testing.assert_allclose(20 * np.log10(factors), [[-10.0, 0.0], [0.0, -5.0]], atol=0.1)


def test_a_fast_clock_hears_lower_tones():
    world = SoundWorld(RATE, [Source(at([3.0, 0, 0]), ToneSignal(10000.0))], microphones=1, noise=Noise(None), clock_ppm=200.0)
    heard = world.render(4 * RATE, np.zeros((2, 1, 3)))[RATE:, 0]
    assert frequency_of(heard) == pytest.approx(10000.0 / (1 + 200e-6), abs=0.05)


@pytest.mark.parametrize('surroundings', [None, Surroundings(ground=Ground(), zones=[ReverbZone((-9, -9, 0), (9, 9, 9))])])
def test_everything_at_once_is_the_same_for_any_block_size(surroundings):
    pair = np.array([[0.0, 0.1, 1.5], [0.0, -0.1, 1.5]])

    def path(t):
        return np.stack([8.0 * np.cos(t), 8.0 * np.sin(t), 5.0 + np.sin(2 * t)], axis=1)

    def whole(block):
        sources = [Source(path, RotorSignal(), directivity=RotorDirectivity()), Source(at([5, 5, 1]), ToneSignal())]
        world = SoundWorld(RATE, sources, Medium(absorption=True), surroundings=surroundings, seed=2, clock_ppm=30.0)
        parts = []
        for start in range(0, 14400, block):
            instants = np.arange(start, start + block + 1, 160) / RATE
            turned = [pair @ np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in instants]
            parts.append(world.render(block, np.array(turned)))
        return np.concatenate(parts).tobytes()

    assert whole(480) == whole(1600) == whole(14400)


def test_a_jump_is_named():
    with pytest.raises(ValueError, match='source 0 or the rig jumps'):
        hear([Source(lambda t: np.stack([5.0 + 400.0 * (t > 0.5), 0 * t, 0 * t], axis=1), ToneSignal())])


def test_everything_can_be_written_in_yaml():
    """The dataclasses are the schema of scenarios."""
    surroundings = read(Surroundings, {
        'ground': {'surface': 'gravel'}, 'obstacles': [
            {'kind': 'box', 'center': [1, 2, 3], 'size': [4.0, 0.2, 2.0], 'absorption': [0.1, 0.2, 0.3, 0.3, 0.3, 0.3]},
            {'kind': 'trunk', 'center': [5.0, 5.0]}],
        'zones': [{'minimum': [0, 0, 0], 'maximum': [5, 5, 5], 'decay_s': 0.8}]})
    assert surroundings.obstacles[0].top == 4.0 and surroundings.zones[0].decay_s == 0.8
    assert read(Surroundings, {'room': {'minimum': [0, 0, 0], 'maximum': [5, 5, 5], 'order': 1}}).room.order == 1
    noise = read(Noise, {'wind': {'velocity': [3, 0, 0]}, 'ego_rotors': {'signal': {'blades': 3}, 'rotors': [[0.1, 0, 0]] * 4}})
    assert noise.ego_rotors.signal.blades == 3


def test_a_long_flight_needs_no_more_memory_than_a_short_one():
    tracemalloc.start()
    stream, held = RotorSignal(rotor_hz=(90.0,)).stream(8000, [1], at([0, 0, 0])), []
    for until in (400, 1200):
        for second in range(until - 400, until, 5):
            stream.read(second * 8000, second * 8000 + 1)
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[1] - held[0] < 20_000  # what was remembered of every chunk would be 100,000


@pytest.mark.parametrize('file', sorted(PROFILES.glob('*.yaml')), ids=lambda file: file.stem)
def test_shipped_profiles_sound(file):
    profile = load_profile(file)
    heard = hear([Source(at([5.0, 0, 5.0]), profile.signal, directivity=profile.directivity)])
    level = 20 * np.log10(heard[RATE // 4:].std() / 20e-6)
    assert 30.0 < level < 90.0


def test_there_are_profiles_of_several_kinds():
    assert len(list(PROFILES.glob('*.yaml'))) >= 5
