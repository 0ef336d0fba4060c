"""The simulated sound's own figures, less those of time; a figure that misses its bound, and an unknown section, show."""

import pytest

from av_evaluation.cli import simulated_sound
from av_evaluation.figures import Figure


@pytest.mark.parametrize('section', ['fly_by', 'moving_rig', 'air'])
def test_what_must_hold_holds(section, capsys):
    assert simulated_sound.main([section]) == 0
    assert 'ok' in capsys.readouterr().out


def test_a_missed_limit_shows(monkeypatch, capsys):
    monkeypatch.setitem(simulated_sound.SECTIONS, 'air', lambda: iter([Figure('too much', 2.0, 'dB', at_most=1.0)]))
    assert simulated_sound.main(['air']) == 1
    assert 'MISSED' in capsys.readouterr().out


def test_an_unknown_section_is_named(capsys):
    with pytest.raises(SystemExit):
        simulated_sound.main(['smell'])
    assert 'unknown section smell' in capsys.readouterr().err
