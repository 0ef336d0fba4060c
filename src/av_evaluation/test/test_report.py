"""The report of the publication's experiments, and the README's table of measured values."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from av_evaluation.cli.evaluate import main as evaluate
from av_evaluation.cli.report import (
    BEGIN,
    END,
    EXPERIMENTS,
    cases_of,
    make_page,
    measured_table,
    measured_version,
    metrics_by_experiment,
    write_readme,
)
from av_evaluation.experiments.physical import labelled_azimuths, longest_take, moving_through
from av_evaluation.metrics.results import MethodResult, RunResult, write_json
from av_evaluation.runs import program

PROJECT = Path(__file__).resolve().parents[3]
README, METRICS = PROJECT / 'README.md', PROJECT / 'docs' / 'measured' / 'metrics.json'


def disagreement(readme, metrics):
    """The difference between the table of the README and that of metrics.json, empty if they agree."""
    expected = measured_table(json.loads(metrics.read_text()))
    written = readme.read_text().split(BEGIN)[-1].split(END)[0].strip()
    return '' if written == expected else f'{readme} has\n{written}\nbut {metrics} gives\n{expected}'


def made_up(case, error_deg):
    """A run in which every method is off by about as much."""
    time = np.arange(0.0, 20.0, 0.1)
    random = np.random.default_rng(case.seed)

    def method():
        errors = error_deg + random.normal(0.0, 0.1, len(time))
        return MethodResult(time, np.radians(errors), time, errors, np.zeros(len(time), bool), 1.0, 20.0, 1.0)
    return RunResult(case.name, case.key, {'input': case.input}, 20.0, {name: method() for name in case.methods},
                     truth={'time': time, 'azimuth': 0.0 * time},
                     state={'time': time, 'state': 1.0 + (time > 10.0), 'sigma': 0.1 + 0.0 * time})


def test_the_report_shows_the_four_experiments_and_both_tables(tmp_path):
    groups = cases_of(1, True, tmp_path)
    runs = {name: [made_up(case, 2.0) for case in cases] for name, cases in groups.items()}
    page = tmp_path / 'report.html'
    metrics = metrics_by_experiment(runs)
    make_page(runs, metrics, 'make report QUICK=1').write(page)
    text = page.read_text()
    for part in ('Table 1', 'Table 3', 'Figure 9', 'Figure 11', 'Figure 13', 'Figure 14', '4.11°', '5.89°',
                 'make report QUICK=1'):
        assert part in text
    assert set(EXPERIMENTS) < set(metrics)
    assert metrics['circle']['fused']['rmse_deg'] == pytest.approx(2.0, abs=0.05)
    low, high = (metrics['all']['fused'][key] for key in ('rmse_low_deg', 'rmse_high_deg'))
    assert low < metrics['all']['fused']['rmse_deg'] < high


def test_the_whole_report_is_the_quick_one_several_times(tmp_path):
    quick, whole = cases_of(1, True, tmp_path), cases_of(5, False, tmp_path)
    assert set(quick) < set(whole) and all(set(cases) <= set(whole[name]) for name, cases in quick.items())


def test_the_readme_agrees_with_the_measured_values():
    """Made to agree by `make report`."""
    assert disagreement(README, METRICS) == ''


def test_a_readme_that_disagrees_is_found(tmp_path):
    content = json.loads(METRICS.read_text())
    readme, metrics = tmp_path / 'README.md', tmp_path / 'metrics.json'
    readme.write_text(f'before\n{BEGIN}\n{measured_table(content)}\n{END}\nafter\n')
    content['experiments']['circle, detector']['fused']['rmse_deg'] += 1.0
    write_json(metrics, content)
    assert 'but' in disagreement(readme, metrics)
    write_readme(readme, content)
    assert disagreement(readme, metrics) == '' and readme.read_text().startswith('before\n')
    assert readme.read_text().endswith('\nafter\n')
    readme.write_text('nothing')
    with pytest.raises(ValueError, match='no line'):
        write_readme(readme, content)


def test_the_version_measured_is_a_commit_and_whether_files_differ(tmp_path, monkeypatch):
    assert measured_version(tmp_path) == ''
    file = tmp_path / 'code.py'
    file.write_text('x = 1')
    for words in (['init', '-q'], ['add', '.'], ['-c', 'user.name=a', '-c', 'user.email=a@b', 'commit', '-qm', 'one']):
        subprocess.run(['git', *words], cwd=tmp_path, check=True)
    version = measured_version(tmp_path)
    assert f'commit {version}.' in measured_table({'version': version, 'experiments': {}})
    file.write_text('x = 2')
    assert measured_version(tmp_path) == f'{version}, changed'
    monkeypatch.setenv('PATH', '')    # where git is not installed
    assert measured_version(tmp_path) == ''


def test_programs_report_errors_and_how_to_continue(tmp_path, monkeypatch, capsys):
    """Of what was computed before Ctrl-C nothing is lost: test_evaluate."""
    assert evaluate(['circle', '--methods', 'guessing', '--out', str(tmp_path)]) == 2
    assert "method 'guessing', expected one of fused" in capsys.readouterr().err
    monkeypatch.setattr(program, 'as_completed', lambda *_: (_ for _ in ()).throw(KeyboardInterrupt()))
    monkeypatch.setattr(program, 'run_case', len)    # of a case, which is an error
    assert evaluate(['circle', '--out', str(tmp_path)]) == 130
    assert 'the same command continues where it stopped' in capsys.readouterr().err


def test_labels_become_azimuths(tmp_path):
    """The image's middle is ahead, left is positive; frames without a label lie between their neighbours."""
    file = tmp_path / 'clip.csv'
    file.write_text('frame,label,x,y,width,height\n0,DRONE,309.5,245,20,20\n4,DRONE,109.5,245,20,20\n')
    azimuths = labelled_azimuths(file)
    assert len(azimuths) == 5 and azimuths[0] == pytest.approx(0.0, abs=0.01) and azimuths[4] > 0.3
    assert azimuths[2] == pytest.approx(azimuths[[0, 4]].mean())
    with pytest.raises(FileNotFoundError):
        labelled_azimuths(tmp_path / 'none.csv')


def test_the_longest_take_of_a_spliced_film_is_used():
    slow = np.radians(np.linspace(0.0, 60.0, 40))  # 45 deg/s
    assert longest_take(slow) == (0, 40)
    assert longest_take(np.concatenate([slow[:10], slow[25:], slow[:5]])) == (10, 25)


def test_a_voice_moves_between_measured_directions():
    """Responses that are delays of one sample a step: the voice's delay follows the azimuth."""
    grid = np.radians(np.arange(0.0, 360.0, 5.0))
    responses = np.zeros((len(grid), 2, 8))
    for k in range(len(grid)):
        responses[k, 0, 0] = responses[k, 1, min(k, 7)] = 1.0
    voice = np.random.default_rng(0).normal(size=48_000)
    still = moving_through(voice, np.full(30, grid[3]), grid, responses, 48_000)
    assert np.allclose(still[3:, 1], still[:-3, 0], atol=1e-6)
    between = moving_through(voice, np.full(30, 0.5 * (grid[3] + grid[4])), grid, responses, 48_000)
    peak = between[:, 0]
    assert np.allclose(between[4:, 1], 0.5 * (peak[1:-3] + peak[:-4]), atol=1e-6)
