"""Computes cases in parallel processes; kept results are read from disk."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from av_evaluation.metrics.results import RunResult
from av_evaluation.runs.cases import Case
from av_evaluation.runs.runs import run_case

Report = Callable[[int, int, str], None]  # finished runs, all runs, name of the last one


def run_cases(cases: Sequence[Case], out: Path, workers: int = 0, report: Report = lambda done, total, text: None
              ) -> tuple[list[RunResult], dict[str, str]]:
    """Compute cases; returns their results in order, and reasons of failures by the names of cases.

    Parameters:
        cases: to compute.
        out: folder in which results are kept.
        workers: processes, 0 for one for each core.
        report: called after each run.
    """
    out.mkdir(parents=True, exist_ok=True)
    results: dict[int, RunResult] = {}
    failures: dict[str, str] = {}
    keys = [(case.name, case.key) for case in cases]
    for number, (name, key) in enumerate(keys):
        kept = RunResult.load(out, name, key)
        if kept is not None:
            results[number] = kept
    left = [number for number in range(len(cases)) if number not in results]
    report(len(results), len(cases), '')
    if not left:
        return [results[number] for number in sorted(results)], failures
    os.environ.setdefault('OMP_NUM_THREADS', '1')  # one core each
    # A keyboard interrupt is reported by this process only.
    pool = ProcessPoolExecutor(min(workers or os.cpu_count() or 1, len(left)), multiprocessing.get_context('spawn'),
                               signal.signal, (signal.SIGINT, signal.SIG_DFL))
    try:
        running = {pool.submit(run_case, cases[number]): number for number in left}
        for future in as_completed(running):
            number = running[future]
            try:
                results[number] = future.result()
            except (ValueError, OSError) as error:
                failures[cases[number].name] = str(error)
            except Exception as error:  # noqa: BLE001  a failed run, such as a method of others, must not end the others
                failures[cases[number].name] = f'{type(error).__name__}: {error}{error.__cause__ or ""}'
            else:
                results[number].key = keys[number][1]
                results[number].save(out)
            report(len(results) + len(failures), len(cases), cases[number].name)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return [results[number] for number in sorted(results)], failures
