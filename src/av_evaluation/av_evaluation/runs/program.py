"""Common parts of all programs: exit codes, messages of errors, progress, and parallel processes.

Cases are computed in parallel; kept results are read from disk.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path

from av_common.arguments import whole
from av_evaluation.metrics.results import RunResult
from av_evaluation.runs.cases import Case, run_case


class Progress:
    """What is done, on standard error: a line for each tenth.

    Parameters:
        unit: of what is counted: `runs`, or `s` of one run.
        quiet: whether to print nothing.
    """

    def __init__(self, unit: str = 'runs', quiet: bool = False) -> None:
        self._unit, self._quiet, self._began = unit, quiet, time.monotonic()
        self._first: float | None = None
        self._shown = 0.0

    def show(self, done: float, total: float, text: str = '') -> None:
        """Print the progress, where it is due; the first call only sets what was done before.

        Parameters:
            done: so far.
            total: of all.
            text: name of what was done last.
        """
        if self._first is None:
            self._first = self._shown = done
            if done and not self._quiet:
                print(f'{done:g} of {total:g} {self._unit} were computed before', file=sys.stderr)
        elif not self._quiet and (done >= self._shown + 0.1 * total or done >= total):
            elapsed, self._shown = time.monotonic() - self._began, done
            left = elapsed / max(done - self._first, 1e-9) * (total - done)
            print(f'{done:.0f}/{total:.0f} {self._unit}, {elapsed:.0f} s, {left:.0f} s left: {text}', file=sys.stderr)


def add_run_options(parser: argparse.ArgumentParser, written: str) -> None:
    """Add the options for output, parallel processes and progress.

    Parameters:
        parser: of the program.
        written: names of the files that the program writes, for the help text.
    """
    add = parser.add_argument
    add('--out', type=Path, required=True, help=f'folder for {written} and the result of each run')
    add('--workers', type=whole, default=0, help='parallel processes; 0: one for each core')
    add('--quiet', action='store_true', help='print no progress')
    parser.set_defaults(kept='; the same command continues where it stopped')


def run_program(work: Callable[[argparse.Namespace], int], parser: argparse.ArgumentParser, arguments: Sequence[str] | None,
                refused: int = 2) -> int:
    """Run a program; returns the exit code of its work, or 130 after Ctrl-C. An error is printed in one line.

    Parameters:
        work: takes the options, with the typed command as `command`.
        parser: of the program.
        arguments: of the command line; those of this process where None.
        refused: exit code after an error.
    """
    options = parser.parse_args(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    options.command = ' '.join(['ros2 run av_evaluation', parser.prog, *words])
    try:
        return work(options)
    except (ValueError, OSError, ImportError) as error:
        print(f'{parser.prog}: {error}', file=sys.stderr)
        return refused
    except KeyboardInterrupt:
        print(f'\n{parser.prog}: interrupted{getattr(options, "kept", "")}', file=sys.stderr)
        return 130


@contextmanager
def processes(workers: int = 0) -> Iterator[ProcessPoolExecutor]:
    """Processes of one core each, as many as cores where `workers` is 0. A keyboard interrupt is reported by this one only."""
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    pool = ProcessPoolExecutor(workers or os.cpu_count() or 1, multiprocessing.get_context('spawn'), signal.signal,
                               (signal.SIGINT, signal.SIG_DFL))
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def compute(groups: Mapping[str, Sequence[Case]], options: argparse.Namespace
            ) -> tuple[dict[str, list[RunResult]], list[str]]:
    """Compute groups of cases, equal ones once; returns results by group, and which cases failed, which is printed, too.

    Parameters:
        groups: cases by group.
        options: those of `add_run_options`.
    """
    folder, progress, failures = options.out / 'runs', Progress(quiet=options.quiet), list[str]()
    folder.mkdir(parents=True, exist_ok=True)
    by_key = {case.key: case for group in groups.values() for case in group}
    results = {key: kept for key, case in by_key.items() if (kept := RunResult.load(folder, case.name, key)) is not None}
    left = [key for key in by_key if key not in results]
    progress.show(len(results), len(by_key))
    with processes(options.workers) as pool:
        running = {pool.submit(run_case, by_key[key]): key for key in left}
        for future in as_completed(running):
            key, name = running[future], by_key[running[future]].name
            try:
                results[key] = future.result()
            except (ValueError, OSError) as error:
                failures.append(f'{name} failed: {error}')
            except Exception as error:  # noqa: BLE001  a failed run, such as a method of others, must not end the others
                failures.append(f'{name} failed: {type(error).__name__}: {error}{error.__cause__ or ""}')
            else:
                results[key].save(folder)
            progress.show(len(results) + len(failures), len(by_key), name)
    for failure in failures:
        print(failure, file=sys.stderr)
    return {name: [results[case.key] for case in group if case.key in results] for name, group in groups.items()}, failures
