"""The program `evaluate`: scenarios, bags and folders in; one table, one metrics.json and one report out."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
import yolo_models
from bag_messages import flight
from matplotlib.figure import Figure

from av_common.parameters import node_parameters
from av_evaluation.cli import report
from av_evaluation.cli.evaluate import main
from av_evaluation.metrics.results import MethodResult, RunResult, figures_together
from av_evaluation.report.page import Page
from av_evaluation.runs import cases, program
from av_evaluation.runs.cases import Case, find_inputs, is_bag, run_case

FIGURES = {'coverage', 'rmse_deg', 'mae_deg', 'median_deg', 'p95_deg', 'outliers', 'hemisphere_errors', 'time_to_resolve_s',
           'latency_ms', 'within'}


def one_process(monkeypatch):
    """Compute in this process: starting others takes longer than what is computed."""
    class Pool:
        def submit(self, call, case):
            from concurrent.futures import Future
            future = Future()
            try:
                future.set_result(call(case))
            except (ValueError, OSError) as error:
                future.set_exception(error)
            return future

        def shutdown(self, **_):
            pass
    monkeypatch.setattr(program, 'ProcessPoolExecutor', lambda *_: Pool())


def test_a_wrong_rig_is_named_before_anything_is_computed(tmp_path, capsys):
    assert main(['circle', '--oracle', '--rig', 'nowhere', '--out', str(tmp_path / 'out')]) == 2
    words = capsys.readouterr().err.splitlines()
    assert len(words) == 1 and words[0].startswith('evaluate: nowhere: no such file')


@pytest.mark.parametrize(('program', 'inputs'), [(main, ['circle']), (report.main, ['--quick', '--data', 'nowhere'])])
def test_a_model_that_cannot_be_used_is_named_before_anything_is_computed(tmp_path, capsys, program, inputs):
    """Not once for each run: a file that is missing, and one of other classes."""
    other = yolo_models.write(tmp_path / 'other.onnx', metadata={'names': "['gull', 'UAV', 'kite']"})
    for model, reason in ((tmp_path / 'missing.onnx', 'does not exist'), (other, "not ['drone']: name those that are drones")):
        assert program([*inputs, '--model', str(model), '--out', str(tmp_path / 'out')]) == 2
        words = capsys.readouterr().err.splitlines()
        assert str(model) in words[-1] and reason in words[-1] and sum(reason in line for line in words) == 1
        assert not list(tmp_path.glob('out/*'))


def test_bags_and_scenarios_in_folders_are_evaluated_and_kept(tmp_path, monkeypatch, capsys):
    """A bag by rosbags alone, a shipped scenario, and two files of one name that are no bags: these are named."""
    one_process(monkeypatch)
    flight(tmp_path / 'bags' / 'good', duration=12.0)
    (tmp_path / 'bags' / 'broken.mcap').write_bytes(b'no bag at all')
    (tmp_path / 'bags' / 'others').mkdir()
    (tmp_path / 'bags' / 'others' / 'broken.mcap').write_bytes(b'')
    out = tmp_path / 'out'
    command = [str(tmp_path / 'bags'), 'circle', '--oracle', '--seeds', '1', '--duration', '3', '--out', str(out), '--quiet',
               '--methods', 'fused', 'sound', 'sight', 'gated', 'kalman', 'gcc_phat']
    assert main(command) == 1
    printed = capsys.readouterr()
    assert printed.err.count('broken failed: ') == 2 and 'gcc_phat' in printed.err and 'fused (ours)' in printed.out
    metrics = json.loads((out / 'metrics.json').read_text())
    assert FIGURES.issubset(metrics['fused']) and {'fused', 'sound', 'sight'}.issubset(metrics)
    assert metrics['fused']['coverage'] == 1.0 and metrics['fused']['rmse_deg'] < 3.0
    assert metrics['sound']['hemisphere_errors'] is None  # the true hemisphere is given
    runs = json.loads((out / 'runs.json').read_text())
    assert {run['name'] for run in runs} == {'good', 'circle_1'}
    assert 'gcc_phat' in next(run for run in runs if run['name'] == 'good')['missing']
    page = (out / 'report.html').read_text()
    assert page.count('data:image/png;base64,') == 3 and not re.search(r'(src|href)="(?!data:)', page)
    assert len(list((out / 'runs').glob('*.npz'))) == 2

    for broken in (tmp_path / 'bags').rglob('broken.mcap'):
        broken.unlink()
    monkeypatch.setattr(program, 'run_case', lambda case: pytest.fail(f'{case.name} was computed again'))
    assert main(command) == 0
    assert json.loads((out / 'metrics.json').read_text()) == metrics


def test_a_case_is_computed_again_when_anything_about_it_changes(tmp_path):
    path = tmp_path / 'mine.yaml'
    text = 'targets: [{trajectory: {kind: static, position: [5, 0, 2]}}]\nname: mine\n'
    path.write_text(text)
    key = Case(str(path), 1).key
    assert key == Case(str(path), 1).key
    assert len({key, Case(str(path), 2).key, Case(str(path), 1, follow=False).key}) == 3
    path.write_text(text + 'duration: 7.0\n')
    assert Case(str(path), 1).key != key


def test_inputs_are_found_in_folders_and_faults_are_named(tmp_path):
    flight(tmp_path / 'all' / 'one', duration=0.2)
    (tmp_path / 'all' / 'more').mkdir()
    (tmp_path / 'all' / 'more' / 'mine.yaml').write_text('')
    (tmp_path / 'all' / 'more' / 'cut.mcap').write_bytes(b'')
    assert is_bag(tmp_path / 'all' / 'one') and not is_bag(tmp_path / 'all')
    found = [name.split('all/')[-1] for name in find_inputs([str(tmp_path / 'all'), str(tmp_path / 'all' / 'one')])]
    assert found == ['more/cut.mcap', 'more/mine.yaml', 'one']
    (tmp_path / 'all' / 'notes').mkdir()
    (tmp_path / 'empty').mkdir()
    with pytest.raises(ValueError, match='empty: neither bags'):
        find_inputs([str(tmp_path / 'empty')])
    with pytest.raises(FileNotFoundError, match='no such bag'):
        find_inputs(['gone.mcap'])
    (tmp_path / 'flight.wav').write_bytes(bytes(2_000_000))
    with pytest.raises(ValueError, match='flight.wav: neither a bag'):
        find_inputs([str(tmp_path / 'flight.wav')])
    with pytest.raises(ValueError, match='nowhere: no such file'):
        find_inputs(['nowhere'])


def test_the_same_seed_gives_the_same_result_and_another_one_another():
    def errors(seed):
        return run_case(Case('tripod', seed, ('fused', 'sound'), duration=1.0)).methods['sound'].error_deg
    assert np.array_equal(errors(1), errors(1)) and not np.array_equal(errors(1), errors(2))


def test_figures_of_runs_together_are_those_of_all_their_errors(tmp_path):
    """Two runs of known errors, kept on disk in between."""
    def run(name, errors, coverage, span):
        time = 0.1 * np.arange(len(errors))
        error = np.array(errors)
        method = MethodResult(time, time, time, error, error > 90.0, coverage)
        return RunResult(name, 'key', {'input': name}, span, {'fused': method, 'gated': method})
    for result in (run('a', [3.0] * 30, 1.0, 30.0), run('b', [-4.0] * 9 + [100.0], 0.5, 10.0)):
        result.save(tmp_path)
    runs = [RunResult.load(tmp_path, name, 'key') for name in 'ab']
    figures = figures_together(runs, 'fused')
    assert figures['rmse_deg'] == pytest.approx(math.sqrt((30 * 9 + 9 * 16 + 1e4) / 40))
    assert figures['coverage'] == pytest.approx(0.875) and figures['outliers'] == pytest.approx(1 / 40)
    assert figures['hemisphere_errors'] == pytest.approx(1 / 40) and figures['median_deg'] == 3.0
    assert figures['worst_rmse_deg'] == pytest.approx(math.sqrt((9 * 16 + 1e4) / 10))
    assert figures['latency_ms'] is None and figures['runs'] == 2
    assert figures_together(runs, 'music')['rmse_deg'] is None
    assert set(runs[0].methods) == {'fused', 'gated'}
    (tmp_path / 'a-key.npz').write_bytes(b'cut off')
    assert RunResult.load(tmp_path, 'a', 'key') is None


def test_a_page_holds_all_it_shows(tmp_path):
    page = Page('Title & more', 'by `a <command>`')
    page.table(['method', 'x'], [['ours', '1'], ['theirs', '2']], ours='ours')
    page.figure(Figure(), 'a "caption"')
    page.write(tmp_path / 'page.html')
    text = (tmp_path / 'page.html').read_text()
    assert 'Title &amp; more' in text and '<code>a &lt;command&gt;</code>' in text and text.count('class=ours') == 1


def test_scenarios_are_heard_as_the_node_hears():
    """A case of its own default would measure another number of sources than rigs use."""
    assert Case('talker').max_sources == node_parameters('av_audio', 'doa_node').max_sources


def test_a_thermal_rig_looks_with_the_thermal_detector(monkeypatch):
    make, made = cases.detection_stage, []

    def stop(*arguments):
        made.append(make(*arguments))
        raise ValueError('no need to simulate')
    monkeypatch.setattr(cases, 'detection_stage', stop)
    for scenario in ('night_thermal', 'night'):
        with pytest.raises(ValueError, match='no need'):
            run_case(Case(scenario, model='shipped'))
    assert [one.detector.detector.model.path.name for one in made] == ['drone_detector_ir.onnx', 'drone_detector.onnx']
