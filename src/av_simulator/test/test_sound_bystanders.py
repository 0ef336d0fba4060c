"""What else is heard: its signals, and its place in a scenario."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from av_common.config_reader import ConfigError
from av_common.rig import load_rig
from av_simulator import Bystander, Static, World, find_config, load_scenario
from av_simulator.sound import EngineSignal, HelicopterSignal, SirenSignal, ToneSignal, VoiceSignal

RATE = 16_000
SIGNALS = [EngineSignal(), HelicopterSignal(), SirenSignal(), SirenSignal(steps=True), VoiceSignal()]


def samples(signal, seconds=4.0, start=0.0):
    stream = signal.stream(RATE, [7], Static((0.0, 0.0, 0.0)))
    return stream.read(round(start * RATE), round((start + seconds) * RATE))


@pytest.mark.parametrize('signal', SIGNALS)
def test_a_signal_has_its_level_and_depends_on_time_alone(signal):
    sound = samples(signal)
    assert 20.0 * np.log10(sound.std() / 20e-6) == pytest.approx(signal.level_db_spl, abs=0.7)
    np.testing.assert_allclose(samples(signal, 0.5, start=2.0), sound[2 * RATE:2 * RATE + RATE // 2], atol=1e-12)


def test_lines_of_an_engine_and_of_a_helicopter_are_multiples_of_their_rate():
    for signal, rate in ((EngineSignal(revving=0.0, noise=0.0), 70.0), (HelicopterSignal(tail_hz=85.0, noise=0.0), 17.0)):
        spectrum = np.abs(np.fft.rfft(samples(signal)))
        frequency = np.fft.rfftfreq(4 * RATE, 1.0 / RATE)
        loudest = frequency[np.argmax(spectrum)]
        assert loudest / (0.5 * rate) == pytest.approx(round(loudest / (0.5 * rate)), abs=0.02)


@pytest.mark.parametrize('steps', [False, True])
def test_the_pitch_of_a_siren_stays_in_its_range(steps):
    sound = samples(SirenSignal(600.0, 1400.0, 0.5, steps))
    pitches = []
    for start in range(0, len(sound) - 800, 800):  # the loudest line in 50 ms
        spectrum = np.abs(np.fft.rfft(sound[start:start + 800] * np.hanning(800), 8192))
        pitches.append(np.argmax(spectrum) * RATE / 8192)
    assert 580.0 < min(pitches) < 650.0
    assert 1350.0 < max(pitches) < 1420.0


def test_a_voice_has_syllables():
    """Its level changes some four times a second; that of an engine does not."""
    for signal, deep in ((VoiceSignal(), True), (EngineSignal(), False)):
        power = (samples(signal) ** 2).reshape(-1, RATE // 50).mean(axis=1)
        slow = np.abs(np.fft.rfft(power - power.mean())) / power.mean() / len(power)
        assert (slow[12:21].max() > 0.1) == deep  # 3 to 5 Hz


def test_a_bystander_is_heard_and_is_no_target():
    """A tone from the left, of the level of 1 m at 2 m less 6 dB; the truth lists the drone alone."""
    scenario = load_scenario(find_config('circle', 'scenarios'))
    quiet = tuple(dataclasses.replace(target, gain_db=-100.0) for target in scenario.targets)
    tone = Bystander(Static((0.0, 2.0, 1.5)), ToneSignal(1000.0, 80.0))
    noise = dataclasses.replace(scenario.noise, snr=None)
    scenario = dataclasses.replace(scenario, targets=quiet, bystanders=(tone,), noise=noise)
    rig = load_rig(find_config('rig'))
    world = World(scenario, rig)
    sound = np.concatenate([world.advance(1600) for _ in range(20)])[16_000:].T
    level = 20.0 * np.log10(sound.std(axis=1) / 20e-6) + rig.array.full_scale_db_spl - 20.0 * np.log10(1.0 / 20e-6)
    assert level.mean() == pytest.approx(74.0, abs=1.5)
    left, right = np.fft.rfft(sound * np.hanning(sound.shape[1]))[:, round(1000.0 * sound.shape[1] / 48_000)]
    spacing = rig.array.positions[0, 1] - rig.array.positions[1, 1]
    assert np.angle(left / right) == pytest.approx(np.angle(np.exp(2j * np.pi * 1000.0 * spacing / 340.3)), abs=0.05)
    assert len(world.scenario.targets) == 1


def test_a_bystander_that_is_wrong_is_named(tmp_path):
    text = find_config('talker', 'scenarios').read_text()
    for wrong, message in (('{kind: voice, level_db_spl: 71.0}', '{kind: siren, low_hz: 900.0, high_hz: 500.0}'),
                           ('velocity: [0.15, 0.0, 0.0]', 'velocity: [400.0, 0.0, 0.0]')):
        (tmp_path / 'wrong.yaml').write_text(text.replace(wrong, message))
        with pytest.raises(ConfigError, match=r'bystanders\[0\]'):
            load_scenario(tmp_path / 'wrong.yaml')
