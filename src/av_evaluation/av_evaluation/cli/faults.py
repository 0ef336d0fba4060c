"""ros2 run av_evaluation faults: rigs that are not as described, and rigs that are; what is told of them, as a table."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from av_common.arguments import whole, within
from av_evaluation.faults import Faults, Told, cases, faultless, named, scenarios, title, try_fault
from av_evaluation.runs.program import Progress, processes, run_program

SECONDS = 40.0  # of each run
Result = TypeVar('Result')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the table and faultless hours; exits with 1 where a wrong name was certain, or a faultless rig surely wrong."""
    parser = argparse.ArgumentParser(prog='faults', description=__doc__)
    parser.add_argument('--quick', action='store_true', help='single faults, one run each: about a minute')
    parser.add_argument('--seeds', type=whole, default=5, help='runs of each fault (%(default)s); 0: faultless hours only')
    parser.add_argument('--array', choices=('pair', 'square'), default='pair', help='microphones (%(default)s)')
    parser.add_argument('--hours', type=within(0.0, 1000.0), default=0.5, help='of faultless runs, all scenarios by '
                        'measurements that are drawn instead of rendered (%(default)g; ten take some minutes)')
    return run_program(_tell, parser, arguments)


def _tell(options: argparse.Namespace) -> int:
    seeds = range(min(options.seeds, 1) if options.quick else options.seeds)
    faults = list(cases(options.array, options.quick)) if seeds else []
    told = _each(partial(try_fault, seconds=SECONDS, array=options.array), [(one, seed) for one in faults for seed in seeds])
    rows = {title(one): (one, [next(told) for _ in seeds]) for one in faults}
    wrong = _print(rows) if rows else 0
    jobs = list(scenarios(options.hours))
    return 1 if _print_faultless(jobs, _each(faultless, jobs)) or wrong else 0


def _each(call: Callable[..., Result], jobs: Sequence[tuple[Any, int]]) -> Iterator[Result]:
    """What a function gives for each of some jobs, in several processes."""
    progress = Progress()
    progress.show(0, len(jobs))
    with processes() as pool:
        for number, result in enumerate(pool.map(call, *zip(*jobs, strict=True)), 1):
            progress.show(number, len(jobs))
            yield result


def _print(rows: dict[str, tuple[Faults, list[Told]]]) -> int:
    """Print the table of faults; returns how many wrong names were certain."""
    print('| fault | told | after s | certain after s | named rightly | lies before, body / world | after, body / world | '
          'told as |\n|---|---|---|---|---|---|---|---|')
    wrong = 0
    for name, (faults, runs) in rows.items():
        told = [run.fault for run in runs if run.fault is not None]
        right = [fault for fault in told if named(faults, fault)]
        wrong += sum(fault.is_certain for fault in told) - sum(fault.is_certain for fault in right)
        before, after = (np.mean([getattr(run, part) for run in runs], axis=0) for part in ('before', 'after'))
        times = [_median([getattr(run, part) for run in runs]) for part in ('first', 'certain')]
        texts = '; '.join(dict.fromkeys(fault.text for fault in told if fault not in right)) or (right[0].text if right else '')
        print(f'| {name} | {len(told)}/{len(runs)} | {times[0]} | {times[1]} | {len(right)}/{len(told)} | '
              f'{before[0]:.0%} / {before[1]:.0%} | {after[0]:.0%} / {after[1]:.0%} | {texts} |')
    return wrong


def _median(times: list[float]) -> str:
    middle = float(np.median(times))
    return f'{middle:.0f}' if math.isfinite(middle) else '-'


def _print_faultless(jobs: Sequence[tuple[str, int]], runs: Iterator[tuple[float, dict[str, bool]]]) -> int:
    """Print false alarms of the runs of scenarios and seeds; returns how many were certain."""
    seconds, warnings, errors = 0.0, 0, 0
    for (name, seed), (length, told) in zip(jobs, runs, strict=True):
        seconds += length
        for text, certain in told.items():
            warnings, errors = warnings + (not certain), errors + certain
            print(f'{name}, seed {seed}: {"ERROR" if certain else "WARN"} {text}')
    if seconds:
        hours = seconds / 3600.0
        print(f'\n{hours:.2f} h without faults: {errors} false ERROR, {warnings} false WARN ({warnings / hours:.2f} an hour)')
    return errors
