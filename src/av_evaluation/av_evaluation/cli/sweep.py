"""ros2 run av_evaluation sweep [NAME...] --out DIR: errors against noise, fog, distance, speed and spacing."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from av_evaluation.experiments.sweeps import SWEEPS, add_sweep, cases_of, figures_of
from av_evaluation.metrics.comparison import write_json
from av_evaluation.report.page import Page
from av_evaluation.runs.cases import Case
from av_evaluation.runs.program import add_run_options, compute, run_program


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code, 1 where a run failed."""
    return run_program(sweep, make_parser(), arguments)


def sweep(options: argparse.Namespace) -> int:
    """Compute missing runs, write sweeps.json and report.html. Raises ValueError for an unknown sweep."""
    for name in options.names:
        if name not in SWEEPS:
            raise ValueError(f'{name!r} is no sweep, only {", ".join(SWEEPS)}')
    groups: dict[tuple[str, float], list[Case]] = {
        (name, value): cases for name in options.names or SWEEPS
        for value, cases in cases_of(SWEEPS[name], options.seeds, options.duration, options.out).items()}
    runs, failures = compute(groups, options)
    page = Page('Sweeps for the design of a rig',
                f'Figures over {options.seeds} runs of {options.duration:g} s for each value. The rig follows the drone; '
                f"sight is the simulator's visual oracle. Made by `{options.command}`.")
    content = {}
    for name in options.names or SWEEPS:
        content[name] = figures_of({value: several for (varied, value), several in runs.items() if varied == name})
        add_sweep(page, SWEEPS[name], content[name])
        print(f'{SWEEPS[name].title} ({SWEEPS[name].unit}): RMSE of ' + ', '.join(
            f'{value}: {by["fused"]["rmse_deg"]:.2f} deg' for value, by in content[name].items()
            if by['fused']['rmse_deg'] is not None))
    write_json(options.out / 'sweeps.json', content)
    page.write(options.out / 'report.html')
    print(f'see {options.out / "report.html"}')
    return 1 if failures else 0


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='sweep', description=__doc__)
    add = parser.add_argument
    add('names', nargs='*', metavar='NAME', help=f'of {", ".join(SWEEPS)}; all by default')
    add('--seeds', type=int, default=2, help='runs of each value (%(default)s)')
    add('--duration', type=float, default=30.0, help='of each run in s (%(default)s)')
    add_run_options(parser, 'report.html, sweeps.json')
    return parser


if __name__ == '__main__':
    sys.exit(main())
