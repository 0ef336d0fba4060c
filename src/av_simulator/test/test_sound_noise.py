"""Noise: levels, spectra and coherence between microphones against their models."""

import numpy as np
import pytest
from scipy.signal import coherence, csd, welch
from scipy.special import j0

from av_simulator.sound import EgoRotors, Medium, Noise, RotorSignal, Snr, SoundWorld, Source, Wind
from av_simulator.sound.stream import band_power

RATE = 16000
C = Medium().speed_of_sound
PAIR = np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])


def hear(noise, seconds=20.0, microphones=PAIR, sources=()):
    world = SoundWorld(RATE, sources, microphones=len(microphones), noise=noise, seed=3)
    return world.render(int(seconds * RATE), np.stack([microphones, microphones])).astype(float)


def spl(samples):
    return 20 * np.log10(np.sqrt(np.mean(samples**2)) / 20e-6)


def real_coherence(heard, segment=512):
    frequency, cross = csd(heard[:, 0], heard[:, 1], RATE, nperseg=segment)
    powers = [welch(heard[:, channel], RATE, nperseg=segment)[1] for channel in range(2)]
    return frequency, cross / np.sqrt(powers[0] * powers[1])


@pytest.mark.parametrize('noise, level', [
    (Noise(40.0), 40.0), (Noise(None, diffuse_db_spl=55.0), 55.0), (Noise(None, urban_db_spl=60.0, urban_swing_db=0.0), 60.0),
    (Noise(None, wind=Wind((0, 8.0, 0), 66.0, gusts=0.0)), 66.0),
])
def test_levels_are_the_stated_ones_at_every_microphone(noise, level):
    heard = hear(noise, 40.0)
    for channel in range(2):
        assert spl(heard[:, channel]) == pytest.approx(level, abs=0.6)


@pytest.mark.parametrize('noise, model', [
    (Noise(20.0), lambda kd: 0.0 * kd),
    (Noise(None, diffuse_db_spl=50.0), lambda kd: np.sinc(kd / np.pi)),
    (Noise(None, urban_db_spl=50.0), j0),
])
def test_coherence_between_microphones_is_that_of_the_field(noise, model):
    frequency, found = real_coherence(hear(noise, 60.0))
    used = (frequency > 100) & (frequency < 6000)
    np.testing.assert_allclose(found[used].real, model(2 * np.pi * frequency[used] * 0.2 / C), atol=0.09)


def test_wind_decays_between_microphones_and_arrives_later_downwind():
    speed, apart = 10.0, 0.02
    pair = np.array([[0.0, 0.0, 0.0], [apart, 0.0, 0.0]])
    heard = hear(Noise(None, wind=Wind((speed, 0.0, 0.0), 70.0, gusts=0.0)), 120.0, pair)
    frequency, found = real_coherence(heard, 2048)
    used = (frequency > 15) & (frequency < 150)
    phase = 2 * np.pi * frequency[used] * apart / (0.7 * speed)
    np.testing.assert_allclose(np.abs(found[used]), np.exp(-0.116 * phase), atol=0.06)
    np.testing.assert_allclose(np.angle(found[used]), -phase, atol=0.12)
    across = hear(Noise(None, wind=Wind((speed, 0.0, 0.0), 70.0)), 20.0)
    frequency, squared = coherence(across[:, 0], across[:, 1], RATE, nperseg=1024)
    assert squared[frequency > 100].max() < 0.05


def test_wind_rumbles_and_grows_with_the_square_of_its_speed():
    slow, fast = (hear(Noise(None, wind=Wind((speed, 0, 0), gusts=0.0)), 60.0) for speed in (4.0, 8.0))
    assert spl(fast) - spl(slow) == pytest.approx(40 * np.log10(2.0), abs=1.0)
    frequency, power = welch(fast[:, 0], RATE, nperseg=8192)
    slope = np.polyfit(np.log(frequency[20:200]), np.log(power[20:200]), 1)[0]
    assert slope == pytest.approx(-7 / 3, abs=0.15)


def test_the_power_in_a_band_is_that_of_the_tones_in_it():
    """Half of their squared amplitudes, the mean of two channels."""
    times = np.arange(RATE) / RATE
    tones = {150.0: 5.0, 300.0: 2.0, 900.0: 3.0, 1100.0: 7.0}    # amplitudes by frequency
    sound = sum(amplitude * np.sin(2.0 * np.pi * hz * times) for hz, amplitude in tones.items())
    both = np.array([sound, np.zeros(RATE)])
    assert band_power(both, RATE, (200.0, 1000.0)) == pytest.approx(0.5 * 0.5 * (2.0**2 + 3.0**2))


def test_snr_scales_the_sum_of_all_noise():
    source = Source(lambda t: np.broadcast_to([0.0, 5.0, 0.0], (len(t), 3)), RotorSignal())
    kinds = {'wind': Wind((3.0, 0, 0)), 'urban_db_spl': 50.0, 'diffuse_db_spl': 45.0}
    both = hear(Noise(30.0, **kinds, snr=Snr(3.0, distance_m=5.0)), sources=[source])
    clean = hear(Noise(None), sources=[source])

    def in_band(samples):
        frequency, power = welch(samples, RATE, nperseg=4096)
        return power[(frequency >= 200) & (frequency < 4000)].sum()

    ratio = in_band(clean[:, 0]) / in_band((both - clean)[:, 0])
    assert 10 * np.log10(ratio) == pytest.approx(3.0, abs=0.7)


def test_ego_rotors_keep_their_delay_and_level_to_each_microphone():
    signal = RotorSignal(rotor_hz=(100.0,), broadband_db_spl=80.0, tone_db_spl=0.0)
    body = [[0.0, 0.5, 0.0], [0.0, -1.5, 0.0]]
    heard = hear(Noise(None, ego_rotors=EgoRotors(signal, [[0.0, 0.0, 0.0]], body)), 2.0)
    assert spl(heard[:, 0]) - spl(heard[:, 1]) == pytest.approx(20 * np.log10(3.0), abs=0.1)
    spectrum = np.fft.rfft(heard[:, 1]) * np.conj(np.fft.rfft(heard[:, 0]))
    curve = np.fft.irfft(spectrum / np.abs(spectrum), 16 * len(heard))
    assert np.argmax(curve[:RATE * 2]) / (16 * RATE) == pytest.approx(1.0 / C, abs=1.0 / (16 * RATE))


def test_a_source_without_sound_in_the_band_of_the_ratio_is_named():
    tone = Source(lambda t: np.tile([5.0, 0.0, 0.0], (len(t), 1)), RotorSignal())
    with pytest.raises(ValueError, match='source is 0, which is silent from 9000 to 9500 Hz in its first seconds'):
        hear(Noise(snr=Snr(10.0, band_hz=(9000.0, 9500.0))), 0.1, sources=[tone])    # beyond half the sample rate


def test_ego_rotors_without_their_geometry_are_named():
    with pytest.raises(ValueError, match=r'ego rotors have shape \(1, 3\), expected \(4, 3\)'):
        EgoRotors(RotorSignal(), [[0.0, 0.0, 0.0]], PAIR)
    with pytest.raises(ValueError, match='ego rotors: microphones have shape'):
        hear(Noise(ego_rotors=EgoRotors(RotorSignal(rotor_hz=(90.0,)), [[0.0, 0.0, 0.0]])), 0.1)


def test_all_noise_is_the_same_for_any_block_size():
    noise = Noise(30.0, Wind(), 50.0, diffuse_db_spl=40.0)

    def whole(block):
        world = SoundWorld(RATE, [], noise=noise, seed=1)
        return np.concatenate([world.render(block, np.stack([PAIR, PAIR])) for _ in range(16000 // block)])

    assert np.array_equal(whole(160), whole(3200))
