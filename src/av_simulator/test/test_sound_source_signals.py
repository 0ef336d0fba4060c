"""Signals: rotors and recordings."""

import numpy as np
import pytest
import soundfile

from av_simulator.sound import RecordedSignal, RotorSignal

RATE = 48000


def nowhere(times):
    return np.zeros((len(times), 3))


def spl(samples):
    return 20 * np.log10(np.sqrt(np.mean(samples**2)) / 20e-6)


def test_rotor_harmonics_stand_at_multiples_of_the_blade_passing():
    signal = RotorSignal(rotor_hz=(80.0,), blades=3, jitter=0.0, broadband_db_spl=-100.0, imbalance_db=-200.0, tone_db_spl=70.0)
    samples = signal.stream(RATE, [1], nowhere).read(0, RATE)
    spectrum = np.abs(np.fft.rfft(samples))
    strongest = np.sort(np.argsort(spectrum)[-6:])
    np.testing.assert_array_equal(strongest, 240 * np.arange(1, 7))
    assert 20 * np.log10(spectrum[480] / spectrum[240]) == pytest.approx(-3.0, abs=0.01)
    assert spl(samples) == pytest.approx(70.0, abs=0.05)


def test_rotor_speed_wanders_by_the_stated_jitter():
    signal = RotorSignal(rotor_hz=(100.0,), blades=2, jitter=0.01, broadband_db_spl=-100.0, harmonics=1, harmonics_db=(0.0,),
                       imbalance_db=-200.0)
    samples = signal.stream(RATE, [4], nowhere).read(0, 10 * RATE)
    crossings = np.flatnonzero((samples[:-1] < 0) & (samples[1:] >= 0))
    exact = crossings + samples[crossings] / (samples[crossings] - samples[crossings + 1])
    frequency = RATE / np.diff(exact)
    assert frequency.mean() == pytest.approx(200.0, rel=0.005)
    assert 0.006 < frequency.std() / 200.0 < 0.014


def test_rotor_pitch_follows_the_thrust():
    def climbing(t):  # from 2 s with 0.44 g
        return 0.22 * 9.80665 * np.maximum(t - 2.0, 0.0)[:, None] ** 2 * [0.0, 0.0, 1.0]

    faster = RotorSignal(rotor_hz=(100.0,), blades=1, jitter=0.0, broadband_db_spl=-100.0, harmonics=1, harmonics_db=(0.0,))
    stream = faster.stream(RATE, [1], climbing)
    for second, wanted in ((0, 100), (3, 120), (-2, 100)):
        spectrum = np.abs(np.fft.rfft(stream.read(second * RATE, (second + 1) * RATE)))
        assert np.argmax(spectrum) == wanted


def test_reading_order_does_not_matter():
    ordered, jumped = (RotorSignal().stream(RATE, [2], nowhere) for _ in range(2))
    jumped.read(200000, 210000)
    jumped.read(-30000, -20000)
    assert np.array_equal(ordered.read(-5000, 20000), jumped.read(-5000, 20000))


@pytest.mark.parametrize('rate, suffix', [(44100, 'wav'), (16000, 'flac'), (48000, 'ogg')])
def test_recording_of_any_rate_keeps_its_frequency_and_level(tmp_path, rate, suffix):
    file = tmp_path / f'tone.{suffix}'
    soundfile.write(file, np.stack([0.1 * np.sin(2 * np.pi * 1000 * np.arange(rate) / rate), np.zeros(rate)], axis=1), rate)
    samples = RecordedSignal(file, level_db_spl=80.0).stream(RATE, [0], nowhere).read(-RATE // 2, RATE // 2)
    assert np.argmax(np.abs(np.fft.rfft(samples))) == pytest.approx(1000, abs=1)
    assert spl(samples) == pytest.approx(80.0, abs=0.3)


def test_a_recording_is_repeated(tmp_path):
    file = tmp_path / 'noise.wav'
    soundfile.write(file, np.random.default_rng(0).uniform(-0.5, 0.5, 48000) + 0.2, 48000)
    looped = RecordedSignal(file).stream(RATE, [0], nowhere).read(0, 4 * RATE)
    seconds = looped[:45600 * 4].reshape(4, -1)
    np.testing.assert_array_equal(seconds[0], seconds[1])


@pytest.mark.parametrize('sample', [0.0, np.nan, np.inf])
def test_a_recording_without_a_level_is_named(tmp_path, sample):
    file = tmp_path / 'nothing.wav'
    soundfile.write(file, np.append(np.full(4799, 0.5 * bool(sample)), sample), RATE, 'FLOAT')
    with pytest.raises(ValueError, match=r'nothing.wav. is silent, or has samples that are not finite'):
        RecordedSignal(file).stream(RATE, [0], nowhere)


def test_missing_or_unreadable_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match='nothing.wav'):
        RecordedSignal(tmp_path / 'nothing.wav')
    text = tmp_path / 'text.wav'
    text.write_text('no sound')
    with pytest.raises(OSError, match='text.wav'):
        RecordedSignal(text).stream(RATE, [0], nowhere)
