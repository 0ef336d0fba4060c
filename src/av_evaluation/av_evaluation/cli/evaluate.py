"""ros2 run av_evaluation evaluate INPUT... --out DIR: how well each method follows the drone, on identical data."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from av_evaluation.experiments.methods import METHODS
from av_evaluation.metrics.comparison import format_rows, metrics_of, rows_of, taus_of, write_report
from av_evaluation.runs.cases import Case, find_inputs, is_bag
from av_evaluation.runs.program import add_run_options, compute, run_program


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code, 1 where a run failed, 2 if all did."""
    return run_program(evaluate, make_parser(), arguments)


def evaluate(options: argparse.Namespace) -> int:
    """Compute what is not there yet, print the table, write metrics.json, pictures and report."""
    groups, failures = compute({'all': cases_of(options)}, options)
    runs = groups['all']
    if not runs:
        return 2
    show(runs)
    print(f'\nsee {write_report(runs, failures, options.out, options.command)}')
    return 1 if failures else 0


def cases_of(options: argparse.Namespace) -> list[Case]:
    """A case a bag, and one for each seed of a scenario. Raises ValueError or OSError."""
    inputs = find_inputs(options.inputs)
    remap = tuple(text for text in options.remap if text)
    common = {'methods': tuple(options.methods), 'taus': tuple(options.taus), 'duration': options.duration,
              'model': options.model}
    return [case for name in inputs for case in (
        [Case(name, **common, stage=options.stage, parameters=tuple(options.params), remap=remap, namespace=options.namespace)]
        if is_bag(Path(name)) else
        [Case(name, seed, **common, follow=not options.static) for seed in range(1, options.seeds + 1)])]


def show(runs: list) -> None:
    """Print the figures."""
    print(format_rows(*rows_of(metrics_of(runs))))
    for tau, methods in taus_of(runs).items():
        print(f'tau {tau:g}: RMSE' + ','.join(f' {name} {figures["rmse_deg"]:.2f}°' for name, figures in methods.items()
                                              if figures['rmse_deg'] is not None))
    for text in dict.fromkeys(text for run in runs for text in (*run.notes, *run.missing.values())):
        print(f'  ! {text}', file=sys.stderr)


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='evaluate', description=__doc__)
    add = parser.add_argument
    add('inputs', nargs='+', metavar='INPUT', help='bags, scenarios (shipped names or .yaml files), or folders of them')
    add('--seeds', type=int, default=3, help='runs of each scenario (%(default)s)')
    add('--methods', nargs='+', choices=METHODS, default=list(METHODS))
    add('--taus', nargs='*', type=float, default=[], help='further gates on the detection confidence, for fused and gated')
    add('--duration', type=float, default=0.0, help="seconds of each; 0: the scenario's, the bag's")
    add('--model', default='', help="a detector's ONNX file, or 'shipped'; without it scenarios have the simulator's oracle, "
        'and bags their recorded detections')
    add('--static', action='store_true', help='scenarios: the rig turns as the scenario says, not to the target')
    add('--from', dest='stage', choices=('raw', 'doa', 'bearing'), default='', help='bags: from where on to compute anew')
    add('--params', action='append', default=[], metavar='FILE', help="bags: the nodes' parameters; can be repeated")
    add('--remap', nargs='+', action='extend', default=[], metavar='NAME:=TOPIC', help='bags: topics of other names')
    add('--namespace', default='', help='bags: the namespace of the recorded rig')
    add_run_options(parser, 'metrics.json, runs.json, report.html')
    return parser


if __name__ == '__main__':
    sys.exit(main())
