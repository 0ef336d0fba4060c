"""Computes cases in parallel, in processes of this machine or on a Dask cluster; kept results are read from disk."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from av_evaluation.metrics.results import RunResult
from av_evaluation.runs.cases import Case
from av_evaluation.runs.runs import run_case

Report = Callable[[int, int, str], None]  # finished runs, all runs, name of the last one


def run_cases(cases: Sequence[Case], out: Path, workers: int = 0, scheduler: str = '',
              report: Report = lambda done, total, text: None) -> tuple[list[RunResult], dict[str, str]]:
    """Compute cases; returns their results in order, and reasons of failures by the names of cases.

    Parameters:
        cases: to compute.
        out: folder in which results are kept.
        workers: processes, 0 for one for each core.
        scheduler: address of a Dask scheduler; '' for processes of this machine.
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
    with _pool(min(workers or os.cpu_count() or 1, len(left)), scheduler) as (submit, completed):
        running = {submit(run_case, cases[number]): number for number in left}
        for future in completed(running):
            number = running[future]
            try:
                results[number] = future.result()
            except Exception as error:  # noqa: BLE001  a failed run must not end the others
                failures[cases[number].name] = str(error) or type(error).__name__
            else:
                results[number].key = keys[number][1]
                results[number].save(out)
            report(len(results) + len(failures), len(cases), cases[number].name)
    return [results[number] for number in sorted(results)], failures


@contextmanager
def _pool(workers: int, scheduler: str) -> Iterator[tuple[Callable[..., Any], Callable[[Iterable[Any]], Iterable[Any]]]]:
    """Functions to submit a call and to wait for results. Raises ValueError without Dask, OSError without its cluster.

    Parameters:
        workers: number of processes.
        scheduler: address of a Dask scheduler, or ''.
    """
    if scheduler:
        try:
            import distributed  # an optional dependency
        except ImportError as error:
            raise ValueError('--scheduler needs the Python package distributed') from error
        with distributed.Client(scheduler, timeout='20s') as client:
            yield (lambda call, case: client.submit(call, case, pure=False),
                   lambda futures: distributed.as_completed(list(futures)))
        return
    os.environ.setdefault('OMP_NUM_THREADS', '1')  # one core each
    # A keyboard interrupt is reported by this process only.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context('spawn'), signal.signal, (signal.SIGINT, signal.SIG_DFL))
    try:
        futures: Callable[[Iterable[Future]], Iterator[Future]] = as_completed
        yield pool.submit, futures
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
