"""A command that is typed wrong ends at once, with one line that names the argument, its value and what is expected."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
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
    ('front_back --ears --data {}', 'front_back: no drone recordings in'),
    ('range --drones nothing', 'nothing: no such file, the nearest is'),
    ('hearing accuracy --trials 0', "--trials: '0', expected an integer above 0"),
    ('faults --hours nan', "--hours: 'nan', expected a number of 0 to 1000"),
    ('faults --hours 2000', "--hours: '2000', expected a number of 0 to 1000"),
    ('city --duration inf', "--duration: 'inf', expected a number of 2 to 1e+06"),
    ('city --seed -1', "--seed: '-1', expected an integer of 0 or more"),
    ('false_targets --runs 0', "--runs: '0', expected an integer above 0"),
    ('network nothing', 'network: case nothing, expected some of bound'),
    ('fuzz --sequences 0', "--sequences: '0', expected an integer above 0"),
    ('attack --port-offset 70000', "--port-offset: '70000', expected an integer of -9998 to 34535")])
def test_a_wrong_argument_is_named_with_its_value(typed, complaint, tmp_path, capsys):
    program, *arguments = typed.format(tmp_path).split()
    try:
        code = import_module(f'av_evaluation.cli.{program}').main(arguments)
    except SystemExit as ended:    # of argparse
        code = ended.code
    assert code == 2
    assert complaint in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.system
@pytest.mark.parametrize(('typed', 'begun'), [('multi_target {0}/1.yaml {0}/9999.yaml', '1.yaml'), ('network flight', 'now')])
def test_ctrl_c_ends_a_program_in_one_line(typed, begun, tmp_path):
    """In a terminal all of its processes get the signal; none shows where it was. One drone is at the rig's own place."""
    for seconds in (1, 9999):
        places = ({'kind': 'static', 'position': [float(x), 0.0, 1.5]} for x in (0, 9))
        (tmp_path / f'{seconds}.yaml').write_text(json.dumps({
            'name': 'two', 'duration': float(seconds), 'targets': [{'trajectory': place} for place in places]}))
    program, *arguments = typed.format(tmp_path).split()
    code = f'import sys; from av_evaluation.cli.{program} import main; sys.exit(main({arguments}))'
    with subprocess.Popen([sys.executable, '-u', '-c', code], start_new_session=True, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)) as run:
        while begun not in run.stdout.readline():    # it computes, and so do its processes
            pass
        os.killpg(run.pid, signal.SIGINT)
        assert run.stderr.read() == f'\n{program}: interrupted\n'
    assert run.returncode == 130


@pytest.mark.system
def test_a_soak_of_a_rig_that_does_not_start_shows_why(tmp_path, capfd):
    assert soak.main(['--minutes', '1', '--out', str(tmp_path), 'source:=nowhere']) == 2
    assert 'nowhere' in capfd.readouterr().err
