"""ros2 run av_evaluation faults: rigs that are not as described; is it told, when and by what name? As a table."""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
from collections.abc import Sequence
from functools import partial

import numpy as np

from av_evaluation.faults.faulty_rig import Faults
from av_evaluation.faults.matrix import SCENARIOS, Told, cases, faultless, named, title, try_fault
from av_evaluation.progress import Progress


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the table, or faultless scenarios; exits with 1 where a wrong name was certain, or a faultless rig was blamed."""
    parser = argparse.ArgumentParser(prog='faults', description=__doc__)
    parser.add_argument('--quick', action='store_true', help='single faults, one run each: about a minute')
    parser.add_argument('--seeds', type=int, default=5, help='runs of each fault (%(default)s)')
    parser.add_argument('--seconds', type=float, default=40.0, help='of each run (%(default)g)')
    parser.add_argument('--array', choices=('pair', 'square', 'eight'), default='pair', help='microphones (%(default)s)')
    parser.add_argument('--faultless', nargs='*', metavar='SCENARIO',
                        help=f'simulate scenarios without faults instead, by default {", ".join(SCENARIOS)}')
    parser.add_argument('--processes', type=int, default=os.cpu_count() or 1, help='at a time (%(default)s)')
    options = parser.parse_args(arguments)
    if min(options.seeds, options.processes) < 1 or not 5.0 <= options.seconds <= 600.0:
        parser.error('expected seeds and processes above 0, and 5 to 600 seconds')
    seeds = range(1 if options.quick else options.seeds)
    with multiprocessing.get_context('spawn').Pool(options.processes) as pool:
        if options.faultless is not None:
            return _faultless(pool, [(name, seed) for name in options.faultless or SCENARIOS for seed in seeds])
        rows = list(cases(options.array, options.quick))
        jobs = [(faults, seed) for faults in rows for seed in seeds]
        progress = Progress()
        progress.show(0, len(jobs))
        call = partial(_job, options.seconds, options.array)
        results: dict[str, list[Told]] = {}
        for number, (faults, told) in enumerate(pool.imap(call, jobs), 1):
            results.setdefault(title(faults), []).append(told)
            progress.show(number, len(jobs), title(faults))
    return _print({title(faults): (faults, results[title(faults)]) for faults in rows})


def _job(seconds: float, array: str, job: tuple[Faults, int]) -> tuple[Faults, Told]:
    return job[0], try_fault(job[0], job[1], seconds, array)


def _print(rows: dict[str, tuple[Faults, list[Told]]]) -> int:
    print('| fault | told | after s | certain after s | named rightly | certain and wrong | lies before, body / world '
          '| lies after, body / world |\n|---|---|---|---|---|---|---|---|')
    worst = 0
    for name, (faults, runs) in rows.items():
        told = [run for run in runs if run.fault is not None]
        wrong = sum(run.fault.is_certain and not named(faults, run.fault) for run in told if run.fault)
        right = sum(named(faults, run.fault) for run in told if run.fault)
        worst += wrong
        before, after = (np.mean([getattr(run, part) for run in runs], axis=0) for part in ('before', 'after'))
        times = [_median([getattr(run, part) for run in runs]) for part in ('first', 'certain')]
        print(f'| {name} | {len(told)}/{len(runs)} | {times[0]} | {times[1]} | {right}/{len(told)} | {wrong} | '
              f'{before[0]:.0%} / {before[1]:.0%} | {after[0]:.0%} / {after[1]:.0%} |')
        for text in dict.fromkeys(run.fault.text for run in told if run.fault and not named(faults, run.fault)):
            print(f'  {name} was called: {text}', file=sys.stderr)
    return 1 if worst else 0


def _median(times: list[float]) -> str:
    middle = float(np.median(times))
    return f'{middle:.0f}' if math.isfinite(middle) else '-'


def _faultless(pool: multiprocessing.pool.Pool, jobs: list[tuple[str, int]]) -> int:
    seconds, warnings, errors, progress = 0.0, 0, 0, Progress()
    progress.show(0, len(jobs))
    for number, ((name, seed), (length, told)) in enumerate(zip(jobs, pool.imap(_scenario, jobs), strict=True), 1):
        seconds += length
        progress.show(number, len(jobs), f'{name} {seed}')
        for text, when, certain in told:
            warnings, errors = warnings + (not certain), errors + certain
            print(f'{name}, seed {seed}, {when:.0f} s: {"ERROR" if certain else "WARN"} {text}')
    hours = seconds / 3600.0
    print(f'{hours:.2f} h without faults: {errors} false ERROR, {warnings} false WARN ({warnings / hours:.1f} an hour)')
    return 1 if errors else 0


def _scenario(job: tuple[str, int]) -> tuple[float, list[tuple[str, float, bool]]]:
    return faultless(*job)
