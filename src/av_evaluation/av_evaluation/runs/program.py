"""What the programs that compute many runs have in common: their options, and how they say what went wrong."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from av_evaluation.metrics.results import RunResult
from av_evaluation.runs.cases import Case
from av_evaluation.runs.progress import RunProgress
from av_evaluation.runs.schedule import run_cases

Work = Callable[[argparse.Namespace], int]


def add_run_options(parser: argparse.ArgumentParser, written: str) -> None:
    """Options of where to compute and where to write; `written` names the files that the program makes."""
    add = parser.add_argument
    add('--out', type=Path, required=True, help=f'folder for {written} and what each run gave')
    add('--workers', type=int, default=0, help='parallel processes; 0: one a core')
    add('--scheduler', default='', metavar='ADDRESS', help='of a Dask cluster that computes the runs instead')
    add('--quiet', action='store_true', help='no progress')


def run_program(work: Work, parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    """Do the `work` that the arguments ask for; returns its exit code, 2 after an error that is said, 130 after Ctrl-C.

    The work finds the command as it was typed in `command`.
    """
    options = parser.parse_args(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    options.command = ' '.join(['ros2 run av_fusion', parser.prog, *words])
    try:
        return work(options)
    except (ValueError, OSError) as error:
        print(f'{parser.prog}: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f'\n{parser.prog}: interrupted; the same command goes on where it stopped ({options.out})', file=sys.stderr)
        return 130


def compute(groups: Mapping[str, Sequence[Case]], options: argparse.Namespace) -> tuple[dict[str, list[RunResult]],
                                                                                        dict[str, str]]:
    """What the cases of each group gave, and why others failed, by their names, which is said, too. Equal cases run once."""
    cases = list(dict.fromkeys(case for group in groups.values() for case in group))
    results, failures = run_cases(cases, options.out / 'runs', options.workers, options.scheduler,
                                  RunProgress(options.quiet).show)
    for name, why in failures.items():
        print(f'{name} failed: {why}', file=sys.stderr)
    done = {result.key: result for result in results}
    return {name: [done[case.key] for case in group if case.key in done] for name, group in groups.items()}, failures
