"""Files of the layouts of DREGON and of the SP Cup 2019, rendered with known directions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.io import savemat

from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_evaluation.cli import flying_arrays

RATE = 44_100
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.04, 0.04)])
ROTORS = np.array([[0.2, 0.2, 0.1], [-0.2, 0.2, 0.1], [-0.2, -0.2, 0.1], [0.2, -0.2, 0.1]])


def delayed(sound, delays):
    """A periodic sound (n,) after delays (m,) in s: (n, m)."""
    turns = np.exp(-2j * np.pi * np.outer(np.fft.rfftfreq(len(sound), 1.0 / RATE), delays))
    return np.fft.irfft(np.fft.rfft(sound)[:, None] * turns, len(sound), axis=0)


def loudspeaker(rng, seconds, azimuth, elevation):
    towards = angles_to_direction(np.radians(azimuth), np.radians(elevation))
    return delayed(rng.normal(size=round(seconds * RATE)), -CUBE @ towards / speed_of_sound(20.0))


def drone(rng, seconds):
    """Four hissing rotors, 14 dB louder than the loudspeaker together."""
    ranges = np.linalg.norm(CUBE[:, None] - ROTORS, axis=2)
    sound = sum(delayed(rng.normal(size=round(seconds * RATE)), ranges[:, k] / speed_of_sound(20.0)) for k in range(4))
    return 5.0 * sound / sound.std() + 0.02 * rng.normal(size=sound.shape)


def write(path, sound):
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, 0.02 * sound, RATE, subtype='PCM_24')


def shares(capsys):
    """The printed percentages by name."""
    lines = [line for line in capsys.readouterr().out.splitlines() if line.endswith('%')]
    return {line[:66].strip(): float(line.split()[-2]) for line in lines}


@pytest.mark.parametrize('alone', ['DREGON_hovering_nosource_room1/DREGON_hovering_nosource_room1',
                                   'DREGON_individual_motors_recordings/DREGON_individual_motors_recordings/allMotors_70'])
def test_flights_of_dregon(tmp_path, capsys, alone):
    """Truth in a frame that is turned by 180 degrees, on a clock that began elsewhere; half of the flight is not tracked.

    The archive of the motors has unpacked into a folder of its own name.
    """
    rng, begin = np.random.default_rng(1), 1.5e9
    np.savetxt(tmp_path / 'micPos.txt', CUBE)
    azimuths = [-150.0, -40.0, 70.0, 160.0]
    flight = np.concatenate([loudspeaker(rng, 1.0, azimuth + 180.0, -30.0) for azimuth in azimuths]) + drone(rng, 4.0)
    stem = tmp_path / 'DREGON_free-flight_whitenoise_room1' / 'DREGON_free-flight_whitenoise_room1'
    write(stem.with_suffix('.wav'), flight)
    savemat(f'{stem}_audiots.mat', {'audio_timestamps': begin + np.arange(4 * RATE) / RATE})
    stamps = np.arange(0.0, 3.0, 0.01)
    truth = np.repeat(azimuths, 100)[:len(stamps)]
    savemat(f'{stem}_sourcepos.mat', {'source_position': {
        'timestamps': begin + stamps, 'azimuth': truth, 'elevation': np.full(len(stamps), -30.0)}})
    write(tmp_path / f'{alone}.wav', drone(rng, 6.0))
    assert flying_arrays.main([str(tmp_path), '--turn', '180']) == 0
    found = shares(capsys)
    assert found['recording of the drone alone, ours: within 10 deg'] > 90.0
    assert found['recording of the drone alone, ours: of those beyond 20 deg'] == 0.0
    assert found['no recording, ours: within 10 deg'] < 50.0


def test_files_of_the_competition(tmp_path, capsys):
    """Two files of one direction each, and one flight with a direction every quarter of a second, motors off."""
    rng = np.random.default_rng(2)
    savemat(tmp_path / 'coordinates.mat', {'micPos': CUBE})
    directions = [(30.0, -10.0), (-120.0, -60.0)]
    for k, (azimuth, elevation) in enumerate(directions):
        write(tmp_path / 'dev_static' / 'audio' / f'{k + 1}.wav', loudspeaker(rng, 2.0, azimuth, elevation))
    savemat(tmp_path / 'dev_static' / 'SPCUP19_dev_static.mat',
            {'static_azimuth': [[30.0], [-120.0]], 'static_elevation': [[-10.0], [-60.0]]})
    write(tmp_path / 'dev_flight' / 'audio' / '1.wav', loudspeaker(rng, 4.0, 100.0, -45.0))
    savemat(tmp_path / 'dev_flight' / 'SPCUP19_dev_flight.mat',
            {'flight_azimuth': np.full((1, 15), 100.0), 'flight_elevation': np.full((1, 15), -45.0)})
    assert flying_arrays.main([str(tmp_path)]) == 0
    found = shares(capsys)
    assert found['no recording, ours: within 10 deg'] == found['no recording, SRP-PHAT: within 10 deg'] == 100.0
    assert not any('alone' in name for name in found)


def dregon(folder, stamps, azimuths, begin=1.5e9):
    """Four seconds of a loudspeaker that is elsewhere each second, motors off, and what is known of its direction."""
    np.savetxt(folder / 'micPos.txt', CUBE)
    stem = folder / 'DREGON_flight' / 'DREGON_flight'
    rng = np.random.default_rng(4)
    write(stem.with_suffix('.wav'), np.concatenate([loudspeaker(rng, 1.0, azimuth, -30.0) for azimuth in DIRECTIONS]))
    savemat(f'{stem}_audiots.mat', {'audio_timestamps': begin + np.arange(4 * RATE) / RATE})
    savemat(f'{stem}_sourcepos.mat', {'source_position': {
        'timestamps': begin + stamps, 'azimuth': azimuths, 'elevation': np.full(len(stamps), -30.0)}})
    return stem


DIRECTIONS = (-150.0, -40.0, 70.0, 160.0)
EACH_10_MS = np.arange(0.0, 4.0, 0.01)


@pytest.mark.parametrize('kept', [EACH_10_MS, EACH_10_MS[::-1], EACH_10_MS[(EACH_10_MS < 0.6) | (EACH_10_MS > 2.9)]],
                         ids=['all', 'the newest first', 'a gap'])
def test_a_frame_is_compared_with_what_is_known_of_its_time(tmp_path, capsys, kept):
    dregon(tmp_path, kept, np.array(DIRECTIONS)[kept.astype(int)])
    assert flying_arrays.main([str(tmp_path)]) == 0
    assert shares(capsys)['no recording, ours: within 10 deg'] == 100.0


@pytest.mark.parametrize('end, content', [
    ('_sourcepos.mat', {'source': 1.0}), ('_sourcepos.mat', {'source_position': np.zeros((3, 3))}),
    ('_sourcepos.mat', {'source_position': {'timestamps': 1.0, 'bearing': 2.0}}), ('_sourcepos.mat', None),
    ('_audiots.mat', {'audio_timestamps': np.zeros((0, 0))}), ('_audiots.mat', {'times': 1.0}), ('_audiots.mat', None)])
def test_files_of_dregon_without_what_belongs_there_are_named(tmp_path, capsys, end, content):
    file = f'{dregon(tmp_path, EACH_10_MS, np.zeros(400))}{end}'
    Path(file).write_bytes(b'no MATLAB file') if content is None else savemat(file, content)
    assert flying_arrays.main([str(tmp_path)]) == 1
    assert f'DREGON_flight{end}' in capsys.readouterr().err


@pytest.mark.parametrize('break_it, said', [
    (lambda folder: (folder / 'micPos.txt').unlink(), 'micPos.txt'),
    (lambda folder: (folder / 'dev_static' / 'audio' / '1.wav').unlink(), '1.wav'),
    (lambda folder: savemat(folder / 'dev_static' / 'SPCUP19_dev_static.mat', {'azimuth': [[1.0]]}), 'SPCUP19_dev_static.mat'),
    (lambda folder: (folder / 'dev_static' / 'SPCUP19_dev_static.mat').unlink(), 'no recording')])
def test_what_is_wrong_is_said(tmp_path, capsys, break_it, said):
    np.savetxt(tmp_path / 'micPos.txt', CUBE)
    write(tmp_path / 'dev_static' / 'audio' / '1.wav', loudspeaker(np.random.default_rng(3), 1.0, 10.0, 0.0))
    savemat(tmp_path / 'dev_static' / 'SPCUP19_dev_static.mat', {'static_azimuth': [[10.0]], 'static_elevation': [[0.0]]})
    break_it(tmp_path)
    assert flying_arrays.main([str(tmp_path)]) == 1
    assert said in capsys.readouterr().err
