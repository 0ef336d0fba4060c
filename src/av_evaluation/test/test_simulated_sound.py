"""The benchmark's own figures, less those of time."""

import pytest

from av_evaluation.cli import simulated_sound
from av_evaluation.simulated_sound import figures


@pytest.mark.parametrize('section', ['fly_by', 'moving_rig', 'air'])
def test_what_must_hold_holds(section, capsys):
    assert simulated_sound.main([section]) == 0
    assert 'holds' in capsys.readouterr().out


def test_a_missed_limit_shows(monkeypatch, capsys):
    monkeypatch.setitem(simulated_sound.SECTIONS, 'air', lambda: iter([figures.Figure('too much', 2.0, 'dB', most=1.0)]))
    monkeypatch.setattr(simulated_sound.SECTIONS['air'], '__doc__', 'Air.', raising=False)
    assert simulated_sound.main(['air']) == 1
    assert 'MISSED' in capsys.readouterr().out


def test_an_unknown_section_is_named(capsys):
    with pytest.raises(SystemExit):
        simulated_sound.main(['smell'])
    assert "section is 'smell'" in capsys.readouterr().err
