"""ros2 run av_evaluation evaluate INPUT... --out DIR: errors of each method on identical measurements."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from av_common.arguments import not_negative, number
from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_evaluation.experiments.methods import METHODS, check_methods, known_methods
from av_evaluation.metrics.results import RunResult, figures_together, methods_of, metrics_of, write_json
from av_evaluation.metrics.tracks import TrackFigures
from av_evaluation.report.charts import bearing_chart, distribution_chart
from av_evaluation.report.page import Page
from av_evaluation.report.text import format_rows, label, rows_of
from av_evaluation.runs.cases import Case, find_inputs, is_bag
from av_evaluation.runs.program import add_run_options, compute, run_program
from av_simulator.config_files import find_config
from av_vision.stage import make_detector


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code, 1 where a run failed, 2 if all did."""
    parser = argparse.ArgumentParser(prog='evaluate', description=__doc__)
    add = parser.add_argument
    add('inputs', nargs='+', metavar='INPUT', help='bags, scenarios (shipped names or .yaml files), or folders of them')
    add('--seeds', type=number, default=3, help='runs of each scenario (%(default)s)')
    add('--methods', nargs='+', metavar='METHOD', default=list(METHODS),
        help=f'to evaluate (default: those of the publication and ours): {", ".join(known_methods())}')
    add('--duration', type=not_negative, default=0.0, help='of each run in s; 0: that of the scenario or bag')
    add('--model', default='', help="a detector's ONNX file, 'shipped', or a detector of another package; without it scenarios "
        'have the shipped one, and bags their recorded detections')
    add('--oracle', action='store_true', help="scenarios: the simulator's visual oracle gives the detections")
    add('--static', action='store_true', help='scenarios: the rig moves as the scenario defines, not towards the target')
    add('--max-sources', type=int, choices=range(1, 5), default=Case.max_sources, metavar='N',
        help='scenarios: directions in one window of sound, 1 to 4 (%(default)s, as doa_node)')
    add('--rig', default='', metavar='FILE', help="scenarios: another description of the rig than the scenario's")
    add('--from', dest='stage', choices=('raw', 'doa', 'bearing'), default='', help='bags: recorded data from which to compute')
    add('--params', action='append', default=[], metavar='FILE', help='bags: parameter file of the nodes; can be repeated')
    add('--remap', nargs='+', action='extend', default=[], metavar='NAME:=TOPIC', help='bags: names of topics in the bag')
    add('--namespace', default='', help='bags: the namespace of the recorded rig')
    add_run_options(parser, 'metrics.json, runs.json, report.html')
    return run_program(evaluate, parser, arguments)


def evaluate(options: argparse.Namespace) -> int:
    """Compute missing runs, print the table, write metrics.json, plots and report."""
    groups, failures = compute({'all': cases_of(options)}, options)
    runs = groups['all']
    if not runs:
        return 2
    show(runs)
    write_report(runs, failures, options.out, options.command)
    print(f'\nsee {options.out / "report.html"}')
    return 1 if failures else 0


def cases_of(options: argparse.Namespace) -> list[Case]:
    """One case for each bag, and for each seed of a scenario. Raises ValueError or OSError, see `find_inputs`."""
    inputs = find_inputs(options.inputs)
    check_methods(tuple(options.methods))
    remap = tuple(text for text in options.remap if text)
    common = {'methods': tuple(options.methods), 'duration': options.duration}
    if options.oracle and options.model:
        raise ValueError('--oracle and --model exclude each other')
    if options.model:    # one that cannot be used would fail each run
        make_detector(node_parameters('av_vision', 'detector_node', options.params, {'model': options.model}))
    if options.rig:
        load_rig(find_config(options.rig))
    seeing = '' if options.oracle else options.model or 'shipped'
    return [case for name in inputs for case in (
        [Case(name, **common, model=options.model, stage=options.stage, parameters=tuple(options.params), remap=remap,
              namespace=options.namespace)]
        if is_bag(Path(name)) else
        [Case(name, seed, **common, model=seeing, follow=not options.static, rig=options.rig,
              max_sources=options.max_sources)
         for seed in range(1, options.seeds + 1)])]


def show(runs: Sequence[RunResult]) -> None:
    """Print the table of figures, and the notes of the runs to standard error."""
    print(format_rows(*rows_of(metrics_of(runs))))
    for run in runs:
        if run.tracks:
            tracks = TrackFigures(**run.tracks)
            print(f'{run.name}: all targets, GOSPA {tracks.gospa_deg:.1f}°, errors {tracks.localisation_deg:.1f}° RMS, '
                  f'{tracks.missed:.1f} missed, {tracks.false:.1f} false, {tracks.switches:.0f} identity switches')
    for text in dict.fromkeys(text for run in runs for text in (*run.notes, *run.missing.values())):
        print(f'  ! {text}', file=sys.stderr)


def write_report(runs: Sequence[RunResult], failures: Sequence[str], out: Path, command: str) -> None:
    """Write metrics.json, runs.json and report.html.

    Parameters:
        runs: to report.
        failures: which runs failed, with the reasons.
        out: existing folder.
        command: by which the report was made.
    """
    metrics = metrics_of(runs)
    write_json(out / 'metrics.json', metrics)
    write_json(out / 'runs.json', [
        {'name': run.name, 'case': run.case, 'notes': run.notes, 'missing': run.missing,
         'tracks': {key: value if math.isfinite(value) else None for key, value in run.tracks.items()} or None,
         'methods': {method: figures_together([run], method) for method in run.methods}} for run in runs])
    page = Page('Evaluation of bearings', f'{len(runs)} runs. Made by `{command}`.')
    page.heading('All runs together')
    page.table(*rows_of(metrics), ours=label('fused'))
    page.paragraph('Errors count from the first detection; without one, from the first bearing with resolved front '
                   'and back. All methods get the same data and the same median filter. Methods of sound alone, and the '
                   'Kalman filter, are given the true one of two hypotheses; those of sound are evaluated at the centre of '
                   'their window. Fused, gated and sight use no truth. Intervals: bootstrap over blocks of 2 s.')
    page.figure(distribution_chart(runs, methods_of(runs)), 'Cumulative distribution of the absolute errors.')
    for name in dict.fromkeys(run.case['input'] for run in runs):
        several = [run for run in runs if run.case['input'] == name]
        page.heading(name)
        page.table(*rows_of(metrics_of(several)), ours=label('fused'))
        for run in several:
            for text in (*run.notes, *run.missing.values()):
                page.paragraph(text)
            page.figure(bearing_chart(run), f'{run.name}: bearing and error.')
    for failure in failures:
        page.paragraph(failure)
    page.write(out / 'report.html')
