"""ros2 run av_evaluation fuzz: random sequences of messages against the stages; exits with 1 where one breaks a promise."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import warnings
from collections.abc import Sequence
from contextlib import suppress

from av_evaluation.attack.fuzz import faults

CHUNK = 100    # sequences of a process at a time
MESSAGES = 40  # of each sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sequences and print those that broke a promise, with the seeds that repeat them; Ctrl-C ends it early."""
    parser = argparse.ArgumentParser(prog='fuzz', description=__doc__)
    parser.add_argument('--sequences', type=int, default=100_000, help='number of sequences (%(default)s)')
    parser.add_argument('--seed', type=int, default=0, help='of the first sequence (%(default)s)')
    parser.add_argument('--processes', type=int, default=os.cpu_count() or 1, help='at a time (%(default)s)')
    options = parser.parse_args(arguments)
    if min(options.sequences, options.processes) < 1 or options.seed < 0:
        parser.error('expected numbers above 0, and a seed of 0 or more')
    end = options.seed + options.sequences
    jobs = [(first, min(CHUNK, end - first), MESSAGES) for first in range(options.seed, end, CHUNK)]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    found, done = 0, 0
    silence = (warnings.simplefilter, ('ignore', RuntimeWarning))    # of absurd numbers
    with suppress(KeyboardInterrupt), multiprocessing.get_context('spawn').Pool(options.processes, *silence) as pool:
        for (_, count, _), faulty in zip(jobs, pool.imap(_faults, jobs), strict=True):
            found, done = found + len(faulty), done + count
            for seed, fault in faulty.items():
                print(f'--seed {seed} --sequences 1: {fault}', flush=True)
    print(f'{found} of {done} sequences break a promise')
    return 1 if found or done < options.sequences else 0


def _faults(job: tuple[int, int, int]) -> dict[int, str]:
    return faults(*job)
