"""A command that is typed wrong ends at once, with one line that names the argument, its value and what is expected."""

from __future__ import annotations

from importlib import import_module

import pytest

from av_evaluation.cli import soak


@pytest.mark.parametrize(('typed', 'complaint'), [
    ('evaluate circle --out {}/a --seeds 0', "--seeds: '0', expected an integer above 0"),
    ('evaluate circle --out {}/a --duration nan', "--duration: 'nan', expected a number of 0 or more"),
    ('evaluate circle --out {}/a --max-sources 9', '--max-sources: invalid choice: 9'),
    ('evaluate circle --out {}/a --workers -2', "--workers: '-2', expected an integer of 0 or more"),
    ('report --out {}/a --seeds 1.5', "--seeds: '1.5', expected an integer of 0 or more"),
    ('multi_target nowhere', 'nowhere: no such file, the nearest is'),
    ('multi_target crossing --seeds 0', "--seeds: '0', expected an integer above 0"),
    ('network --seeds 0', "--seeds: '0', expected an integer above 0"),
    ('front_back --starts -3', "--starts: '-3', expected an integer above 0"),
    ('front_back --ears --data {}', '--data: no drone recordings in'),
    ('range --drones nothing', 'nothing: no such file, the nearest is'),
    ('hearing accuracy --trials 0', "--trials: '0', expected an integer above 0"),
    ('faults --hours nan', "--hours: 'nan', expected a number of 0 or more"),
    ('faults --hours 2000', 'up to 1000 hours'),
    ('city --duration inf', '--duration below 2.0, or no number'),
    ('fuzz --sequences 0', "--sequences: '0', expected an integer above 0"),
    ('attack --port-offset 70000', "--port-offset: '70000', expected an integer from")])
def test_a_wrong_argument_is_named_with_its_value(typed, complaint, tmp_path, capsys):
    program, *arguments = typed.format(tmp_path).split()
    with pytest.raises(SystemExit) as ended:
        import_module(f'av_evaluation.cli.{program}').main(arguments)
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.system
def test_a_soak_of_a_rig_that_does_not_start_shows_why(tmp_path, capfd):
    assert soak.main(['--minutes', '1', '--out', str(tmp_path), 'source:=nowhere']) == 2
    assert 'nowhere' in capfd.readouterr().err
