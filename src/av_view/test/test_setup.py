"""Answers in, files out that the rig accepts."""

from __future__ import annotations

import pytest

from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_view.cli import setup


def answer(monkeypatch, *texts):
    given = iter(texts)

    def say(_question):
        try:
            return next(given)
        except StopIteration:
            raise EOFError from None
    monkeypatch.setattr('builtins.input', say)


def run(folder):
    with pytest.raises(SystemExit) as end:
        setup.main([str(folder)])
    return end.value.code


def test_enter_to_everything_gives_a_rig_that_can_start(monkeypatch, tmp_path, capsys):
    answer(monkeypatch, *[''] * 20)
    assert run(tmp_path / 'rig') == 0
    rig = load_rig(tmp_path / 'rig' / 'rig.yaml')
    assert rig.array.geometry.aperture == pytest.approx(0.2) and rig.gimbal is None
    assert 'rig.launch.py source:=hardware' in capsys.readouterr().out


def test_answers_reach_the_files_and_unusable_ones_are_asked_again(monkeypatch, tmp_path, capsys):
    answer(monkeypatch, 'five', '9', 'respeaker_4', 'ReSpeaker', '100', '16000', '1 2 3', '1 1 2 3', '1 2 3 4', 'here',
           '0 0 0.2', '200', '90', '1280', '720', '60', '/dev/video2', 'perhaps', 'y', '0.1, 0, 0')
    assert run(tmp_path / 'rig') == 0
    assert capsys.readouterr().out.count('expected') >= 6
    rig = load_rig(tmp_path / 'rig' / 'rig.yaml')
    assert rig.array.geometry.channels == 4 and rig.array.mount.rpy_deg[2] == 90.0 and rig.array.mount.position[2] == 0.2
    assert rig.camera.width == 1280 and rig.gimbal.mount.position[0] == 0.1
    audio = node_parameters('av_audio', 'audio_node', [tmp_path / 'rig' / 'params.yaml'])
    assert (audio.device, audio.sample_rate, list(audio.channels)) == ('ReSpeaker', 16_000, [1, 2, 3, 4])
    assert node_parameters('av_vision', 'camera_node', [tmp_path / 'rig' / 'params.yaml']).device == '/dev/video2'


def test_without_answers_nothing_is_written(monkeypatch, tmp_path):
    answer(monkeypatch, '0.15')
    assert run(tmp_path / 'rig') == 2 and not (tmp_path / 'rig').exists()


def test_existing_files_are_kept(monkeypatch, tmp_path):
    (tmp_path / 'rig.yaml').write_text('mine')
    assert run(tmp_path) == 2 and (tmp_path / 'rig.yaml').read_text() == 'mine'
