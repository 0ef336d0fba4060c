"""The verdict on a recording of the rig alone: what it buys and when the rig is deaf."""

import contextlib
import re
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from flying_rig import RING, FlyingRig
from known_sound import PAIR, RATE

from av_audio.cli import guided_recording, record_ego_noise


def flying(array, seconds=6.0):
    rng = np.random.default_rng(3)
    return (0.05 * FlyingRig(array, rng).alone(rng, seconds)[0]).astype(np.float32)


def judged(tmp_path, capsys, sound, array=PAIR):
    """Decibels that a recording buys, up to which it hears, and from which it is deaf, as record_ego_noise prints them."""
    array.save(tmp_path / 'array.yaml')
    soundfile.write(tmp_path / 'alone.wav', sound, RATE, 'FLOAT')
    try:
        record_ego_noise.main([str(tmp_path / 'alone.wav'), '--array', str(tmp_path / 'array.yaml'), '--judge'])
    except SystemExit as ended:
        if isinstance(ended.code, str):
            raise
    return tuple(map(float, re.findall(r'(-?\d+) dB', capsys.readouterr().out)))


def test_a_recording_of_rotors_buys_decibels_and_its_limit_is_said(tmp_path, capsys):
    """Known of such rigs: with a recording a tenth is wrong at 15 dB, two thirds at 20 dB; without it two thirds at 10 dB."""
    gain, heard, deaf = judged(tmp_path, capsys, flying(PAIR))
    assert gain >= 5.0 and 5.0 <= heard <= 15.0 < deaf <= 25.0


def test_a_recording_that_clips_is_told(tmp_path, capsys):
    """What is cut off is not the noise that is heard later."""
    PAIR.save(tmp_path / 'pair.yaml')
    alone = flying(PAIR, 4.0)
    soundfile.write(tmp_path / 'alone.wav', np.clip(alone / (2.0 * alone.std()), -1.0, 1.0), RATE)
    with contextlib.suppress(SystemExit):
        record_ego_noise.main([str(tmp_path / 'alone.wav'), '--array', str(tmp_path / 'pair.yaml'), '--judge'])
    assert 'channel 0 clips' in capsys.readouterr().err


def test_noise_of_the_microphones_cannot_be_bought_off(tmp_path, capsys):
    alone = 0.05 * np.random.default_rng(4).normal(size=(6 * RATE, 2)).astype(np.float32)
    assert judged(tmp_path, capsys, alone)[0] <= 5.0


def test_the_program_records_and_judges(tmp_path, monkeypatch, capsys):
    PAIR.save(tmp_path / 'pair.yaml')
    monkeypatch.setattr(guided_recording, 'pieces', lambda source, requests, *_: [flying(PAIR, 3.0) for _ in requests])
    device = SimpleNamespace(sample_rate=RATE, channels=2)
    monkeypatch.setattr(record_ego_noise, 'DeviceSource', lambda name, rate, channels: device)
    arguments = [str(tmp_path / 'alone.wav'), '--array', str(tmp_path / 'pair.yaml')]
    record_ego_noise.main([*arguments, '--throttle', '40', '60'])
    told = capsys.readouterr()
    assert 'the recording buys' in told.out and not told.err and soundfile.info(tmp_path / 'alone.wav').duration == 6.0
    for name, words in (('alone', 'a name such as sound.wav'), ('absent/alone.wav', 'No such file or directory')):
        with pytest.raises(SystemExit, match=f'record_ego_noise: .*{words}'):
            record_ego_noise.main([str(tmp_path / name), *arguments[1:]])
    RING.save(tmp_path / 'pair.yaml')
    with pytest.raises(SystemExit, match=r'expected \(n, 8\)'):
        record_ego_noise.main([*arguments, '--judge'])
    with pytest.raises(SystemExit):
        record_ego_noise.main([*arguments, '--judge', '--channels', '1', '0'])
    assert '--judge takes the file as doa_node does' in capsys.readouterr().err


def test_one_microphone_in_two_channels_is_no_recording_of_two(tmp_path, capsys):
    """Such own noise has one dimension: whitened by it, targets seem to be heard at any level."""
    one = flying(PAIR)[:, :1]
    with pytest.raises(SystemExit, match='the same sound in channels 0, 1'):
        judged(tmp_path, capsys, np.repeat(one, 2, axis=1))


@pytest.mark.parametrize('rest', [0.3, 0.3 + 2.0**-18 * np.random.default_rng(5).normal(size=(6 * RATE, 1))])
@pytest.mark.parametrize('channels', [slice(None), slice(1)], ids=['all', 'one'])
def test_a_recording_of_an_offset_alone_is_silent(tmp_path, capsys, rest, channels):
    """As of a plug that is out: it was taken for a rig that is deaf."""
    alone = flying(PAIR, 6.0)
    alone[:, channels] = rest
    with pytest.raises(SystemExit, match='has a silent channel'):
        judged(tmp_path, capsys, alone)


def test_a_recording_with_samples_that_are_not_finite_is_refused(tmp_path, capsys):
    """In the half that rates the other, too."""
    alone = flying(PAIR)
    alone[RATE + 100] = np.nan
    with pytest.raises(SystemExit, match='not finite'):
        judged(tmp_path, capsys, alone)
