"""Common parts of the programs that compute many runs: options, exit codes, progress and messages of errors."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from av_evaluation.metrics.results import RunResult
from av_evaluation.progress import Progress
from av_evaluation.runs.cases import Case
from av_evaluation.runs.schedule import run_cases

Work = Callable[[argparse.Namespace], int]
Group = TypeVar('Group', bound=Hashable)


def add_run_options(parser: argparse.ArgumentParser, written: str) -> None:
    """Add the options for output, parallel processes and progress.

    Parameters:
        parser: of the program.
        written: names of the files that the program writes, for the help text.
    """
    add = parser.add_argument
    add('--out', type=Path, required=True, help=f'folder for {written} and the result of each run')
    add('--workers', type=int, default=0, help='parallel processes; 0: one for each core')
    add('--quiet', action='store_true', help='print no progress')


def run_program(work: Work, parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    """Run a program; returns the exit code of its work, 2 after an error, which is printed, and 130 after Ctrl-C.

    Parameters:
        work: takes the options, with the typed command as `command`.
        parser: of the program.
        arguments: of the command line; those of this process where None.
    """
    options = parser.parse_args(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    options.command = ' '.join(['ros2 run av_evaluation', parser.prog, *words])
    try:
        return work(options)
    except (ValueError, OSError) as error:
        print(f'{parser.prog}: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f'\n{parser.prog}: interrupted; the same command continues where it stopped ({options.out})', file=sys.stderr)
        return 130


def compute(groups: Mapping[Group, Sequence[Case]],
            options: argparse.Namespace) -> tuple[dict[Group, list[RunResult]], dict[str, str]]:
    """Compute groups of cases, equal cases once; returns results by group, and reasons of failures by the names of cases.

    Parameters:
        groups: cases by group.
        options: those of `add_run_options`.
    """
    cases = list(dict.fromkeys(case for group in groups.values() for case in group))
    results, failures = run_cases(cases, options.out / 'runs', options.workers, Progress(quiet=options.quiet).show)
    for name, reason in failures.items():
        print(f'{name} failed: {reason}', file=sys.stderr)
    done = {result.key: result for result in results}
    return {name: [done[case.key] for case in group if case.key in done] for name, group in groups.items()}, failures
