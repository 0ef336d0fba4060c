"""Recordings of lossy codes that keep levels and no phases: the direction that is left has no confidence."""

import io

import numpy as np
import pytest
import soundfile
from known_sound import PAIR, RATE, add_noise, flat, rotors
from scipy.signal import butter, fftconvolve, lfilter

from av_audio import Localizer, LocalizerSettings
from av_audio.cli import localize
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction

SETTINGS = LocalizerSettings(hop_s=0.25)


def target(rng, azimuth_deg, kind, seconds=3.0, snr_db=30.0):
    delays = -PAIR.positions @ angles_to_direction(np.radians(azimuth_deg)) / speed_of_sound(20.0)
    sound = rotors(rng, seconds, delays) if kind == 'rotors' else flat(rng, seconds, delays, (100.0, 10_000.0))
    return add_noise(rng, sound, snr_db)


def coded(sound, subtype, level):
    buffer = io.BytesIO()
    with soundfile.SoundFile(buffer, 'w', RATE, 2, subtype, format='OGG', compression_level=level) as file:
        file.write(sound)
    buffer.seek(0)
    return soundfile.read(buffer, always_2d=True)[0]


@pytest.mark.parametrize('kind', ['rotors', 'noise'])
@pytest.mark.parametrize('azimuth_deg', [-75.0, 40.0])
@pytest.mark.parametrize(('subtype', 'level'), [('VORBIS', 0.9), ('VORBIS', 0.95), ('VORBIS', 1.0), ('OPUS', 1.0)])
def test_what_a_code_has_made_of_a_direction_is_not_believed(kind, azimuth_deg, subtype, level):
    """Small files of a code have no phases above some kHz, or none at all: where they tell the direction it is told."""
    sound = coded(target(np.random.default_rng(3), azimuth_deg, kind), subtype, level)
    estimates = Localizer(PAIR, RATE, SETTINGS).process(sound, 0)
    believed = [np.degrees(one.azimuth[0]) for one in estimates if one.confidence[0] > 0.5]
    assert believed == pytest.approx([azimuth_deg] * len(believed), abs=10.0)
    if level == 1.0:
        assert np.mean([one.confidence[0] > 0.5 for one in estimates]) < 0.2


def room(rng, sound):
    """The sound in a room: other reflections at each microphone."""
    response = np.zeros((8000, 2))
    response[0] = 1.0
    for channel in range(2):
        late = rng.integers(50, 8000, 400)
        response[late, channel] += 0.15 * rng.normal(size=400) * np.exp(-late / 3000.0)
    return np.stack([fftconvolve(sound[:, k], response[:, k])[:len(sound)] for k in range(2)], axis=1)


CHANGES = {
    'quiet': lambda rng, sound: sound,
    'noise': lambda rng, sound: add_noise(rng, sound, 0.0),
    'a room': room,
    'an automatic gain': lambda rng, sound: sound * np.repeat(np.exp(0.3 * rng.normal(size=(len(sound) // 4800, 2))), 4800, 0),
    'other microphones': lambda rng, sound: np.stack([sound[:, 0], 0.7 * lfilter(*butter(1, 0.8), sound[:, 1])], axis=1),
    'sixteen bits': lambda rng, sound: np.round(sound * 2000.0) / 32768.0,
}


@pytest.mark.parametrize('change', CHANGES)
@pytest.mark.parametrize('kind', ['rotors', 'noise'])
@pytest.mark.parametrize('snr_db', [10.0, 60.0])
def test_sound_from_ahead_has_no_delay_and_is_believed(kind, change, snr_db):
    rng = np.random.default_rng(4)
    sound = CHANGES[change](rng, target(rng, 0.0, kind, snr_db=snr_db))
    localizer = Localizer(PAIR, RATE, SETTINGS)
    assert len(localizer.process(sound, 0)) > 10 and not localizer.without_phases


@pytest.mark.parametrize('milliseconds', [30, 50, 60])
def test_short_windows_from_ahead_are_believed(milliseconds):
    localizer = Localizer(PAIR, RATE, LocalizerSettings(window_s=1e-3 * milliseconds, hop_s=2560 / RATE))
    assert len(localizer.process(target(np.random.default_rng(7), 0.0, 'noise', 8.0, 60.0), 0)) > 140
    assert not localizer.without_phases


@pytest.mark.parametrize('rate', [8000, 16_000, 44_100])
def test_one_microphone_in_both_channels(tmp_path, capsys, rate):
    sound = np.repeat(0.1 * np.random.default_rng(5).normal(size=(2 * rate, 1)), 2, axis=1)
    soundfile.write(tmp_path / 'mono.wav', sound, rate)
    PAIR.save(tmp_path / 'pair.yaml')
    localize.main([str(tmp_path / 'mono.wav'), '--array', str(tmp_path / 'pair.yaml'), '--csv'])
    printed = capsys.readouterr()
    assert {row.rpartition(',')[2] for row in printed.out.splitlines()[1:]} == {'0.0'}
    assert 'a lossy code has removed the phases' in printed.err
