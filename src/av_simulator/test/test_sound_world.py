"""Propagation against the analytic signal of a fly-by, and the promises of SoundWorld."""

import numpy as np
import pytest

from av_simulator.sound import FormulaSignal, Medium, Noise, RotorSignal, Snr, SoundWorld, Source, ToneSignal
from av_simulator.sound.delays import retarded_delay

RATE = 48000
PAIR = np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
SILENT = Noise(self_noise_db_spl=-200.0)


def straight(start, velocity):
    """A path of constant velocity."""
    return lambda t: np.asarray(start, float) + np.multiply.outer(t, np.asarray(velocity, float))


def exact_delay(start, velocity, microphone, times, c):
    """Travel time from a source of constant velocity: the positive root of |m - p(t - tau)|^2 = (c tau)^2."""
    away = np.asarray(microphone) - straight(start, velocity)(times)
    v = np.asarray(velocity)
    approach = away @ v
    a = c**2 - v @ v
    return (approach + np.sqrt(approach**2 + a * (away**2).sum(axis=1))) / a


def render(world, seconds, block=1600, microphones=PAIR):
    still = np.stack([microphones, microphones])
    return np.concatenate([world.render(block, still) for _ in range(int(seconds * RATE) // block)])


@pytest.mark.parametrize(('start', 'velocity'), [
    ([-20.0, 10.0, 0.0], [20.0, 0.0, 0.0]), ([-160.0, 5.0, 3.0], [134.0, 0.0, 0.0])])
def test_fly_by_is_the_analytic_signal(start, velocity):
    """Up to 0.4 of the speed of sound, with which sound is compressed by 1.67 on the way here."""
    c = Medium().speed_of_sound
    world = SoundWorld(RATE, [Source(straight(start, velocity), ToneSignal(1000.0, 94.0))], noise=SILENT)
    heard = render(world, 2.0)
    times = np.arange(len(heard)) / RATE
    for channel, microphone in enumerate(PAIR):
        delay = exact_delay(start, velocity, microphone, times, c)
        truth = np.sqrt(2.0) * 20e-6 * 10 ** (94 / 20) * np.sin(2 * np.pi * 1000 * (times - delay)) / (c * delay)
        error_db = 10 * np.log10(np.mean((heard[:, channel] - truth) ** 2) / np.mean(truth**2))
        assert error_db < -80.0


def test_delay_of_fast_source_meets_the_closed_form():
    times = np.linspace(-1.0, 1.0, 500)
    start, velocity, microphone = [3.0, 5.0, 2.0], [-90.0, 10.0, 4.0], np.array([0.3, -0.2, 1.0])
    found = retarded_delay(straight(start, velocity), np.broadcast_to(microphone, (500, 3)), times, 343.0)
    np.testing.assert_allclose(found, exact_delay(start, velocity, microphone, times, 343.0), atol=1e-10)


def test_moving_microphone_hears_the_doppler_of_its_own_motion():
    source = Source(straight([100.0, 0, 0], [0, 0, 0]), ToneSignal(1000.0, 94.0))
    world = SoundWorld(RATE, [source], microphones=1, noise=SILENT)
    blocks = [world.render(480, np.array([[[34.3 * t / RATE, 0, 0]] for t in (start, start + 480)]))
              for start in range(0, RATE, 480)]
    heard = np.concatenate(blocks)[24000:, 0].astype(float) * np.hanning(24000)
    peak = np.argmax(np.abs(np.fft.rfft(heard, 16 * 24000))) * RATE / (16 * 24000)
    assert peak == pytest.approx(1000.0 * (1 + 34.3 / Medium().speed_of_sound), abs=0.2)


@pytest.mark.parametrize('moving', [False, True])
def test_same_bytes_for_any_block_size(moving):
    def whole(block):
        sources = [Source(straight([-5.0, 8.0, 3.0], [9.0, 0, 0]), RotorSignal()),
                   Source(straight([4.0, -3.0, 1.0], [0, 2, 0]), ToneSignal())]
        world = SoundWorld(RATE, sources, noise=Noise(snr=Snr(10.0)), seed=7)
        parts = []
        for start in range(0, 14400, block):
            instants = np.arange(start, start + block + 1, 160) / RATE
            way = np.stack([np.array([np.sin(t), 3.0 * t, 0.0]) * moving for t in instants])
            parts.append(world.render(block, PAIR + way[:, None]))
        return np.concatenate(parts).tobytes()

    assert whole(480) == whole(1600) == whole(14400)


def test_seed_changes_the_noise_only_when_it_changes():
    def noise(seed):
        return render(SoundWorld(RATE, [], seed=seed), 0.1)

    assert np.array_equal(noise(1), noise(1))
    assert not np.array_equal(noise(1), noise(2))


def test_snr_holds_at_the_stated_distance_inside_the_band():
    at_8_m = [Source(straight([0.0, 8.0, 0.0], [0, 0, 0]), RotorSignal())]
    both = render(SoundWorld(RATE, at_8_m, noise=Noise(snr=Snr(6.0, distance_m=8.0)), seed=5), 4.0)
    clean = render(SoundWorld(RATE, at_8_m, noise=SILENT, seed=5), 4.0)

    def in_band(signal):
        power = np.abs(np.fft.rfft(signal[:, 0].astype(float))) ** 2
        frequency = np.fft.rfftfreq(len(signal), 1 / RATE)
        return power[(frequency > 200) & (frequency < 4000)].sum()

    assert 10 * np.log10(in_band(clean) / in_band(both - clean)) == pytest.approx(6.0, abs=0.4)


def test_any_formula_can_be_a_signal_and_starts_before_zero():
    click = FormulaSignal(lambda t: np.exp(-((t + 0.05) / 1e-3) ** 2))
    heard = render(SoundWorld(RATE, [Source(straight([0.0, 34.0, 0.0], [0, 0, 0]), click)], noise=SILENT), 0.1)
    arrival = np.argmax(heard[:, 0]) / RATE
    assert arrival == pytest.approx(33.9 / Medium().speed_of_sound - 0.05, abs=1 / RATE)


def test_wrong_shape_is_named():
    with pytest.raises(ValueError, match=r'microphone_positions has shape \(2, 3\), expected \(k, 2, 3\)'):
        SoundWorld(RATE, []).render(480, np.zeros((2, 3)))
