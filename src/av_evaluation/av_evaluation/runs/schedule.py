"""Runs cases side by side: on this machine's cores, or on a Dask cluster. What was computed before is read from disk."""

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

Report = Callable[[int, int, str], None]  # done, of how many, what happened last


def run_cases(cases: Sequence[Case], out: Path, workers: int = 0, scheduler: str = '',
              report: Report = lambda done, total, text: None) -> tuple[list[RunResult], dict[str, str]]:
    """Results in the order of the cases, and why others failed, by their names. Results are kept in `out`.

    `workers`: processes, 0 for one a core. `scheduler`: address of a Dask scheduler to compute there instead.
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
            except Exception as error:  # noqa: BLE001  whatever one run dies of, the others go on
                failures[cases[number].name] = str(error) or type(error).__name__
            else:
                results[number].key = keys[number][1]
                results[number].save(out)
            report(len(results) + len(failures), len(cases), cases[number].name)
    return [results[number] for number in sorted(results)], failures


@contextmanager
def _pool(workers: int, scheduler: str) -> Iterator[tuple[Callable[..., Any], Callable[[Iterable[Any]], Iterable[Any]]]]:
    """How to submit a call, and how to wait for calls. Raises ValueError without Dask, OSError without its cluster."""
    if scheduler:
        try:
            import distributed  # only who has a cluster needs it
        except ImportError as error:
            raise ValueError('--scheduler needs the Python package distributed') from error
        with distributed.Client(scheduler, timeout='20s') as client:
            yield (lambda call, case: client.submit(call, case, pure=False),
                   lambda futures: distributed.as_completed(list(futures)))
        return
    os.environ.setdefault('OMP_NUM_THREADS', '1')  # one core each
    # Of a keyboard interrupt this process says what there is to say.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context('spawn'), signal.signal, (signal.SIGINT, signal.SIG_DFL))
    try:
        futures: Callable[[Iterable[Future]], Iterator[Future]] = as_completed
        yield pool.submit, futures
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
