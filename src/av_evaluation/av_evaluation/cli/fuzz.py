"""ros2 run av_evaluation fuzz: random and invalid measurements; every pointing command must be within its limits."""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor

from av_evaluation.experiments.fuzz import fuzz
from av_evaluation.runs.progress import RunProgress

CHUNK = 250


def main(arguments: list[str] | None = None) -> int:
    """Run the sequences and print faults with their seeds; returns 1 where there are any."""
    parser = argparse.ArgumentParser(prog='fuzz', description=__doc__)
    parser.add_argument('--sequences', type=int, default=100_000, help='number of sequences (%(default)s)')
    parser.add_argument('--messages', type=int, default=20, help='measurements in a sequence (%(default)s)')
    parser.add_argument('--seed', type=int, default=0, help='of the first sequence (%(default)s)')
    parser.add_argument('--workers', type=int, default=0, help='parallel processes; 0: one for each core')
    options = parser.parse_args(arguments)
    begun, broken = time.monotonic(), []
    starts = range(options.seed, options.seed + options.sequences, CHUNK)
    counts = [min(CHUNK, options.seed + options.sequences - start) for start in starts]
    done, progress = 0, RunProgress(quiet=not sys.stderr.isatty())
    progress.show(done, options.sequences)
    with ProcessPoolExecutor(options.workers or os.cpu_count()) as pool:
        for found, count in zip(pool.map(fuzz, starts, counts, [options.messages] * len(starts)), counts, strict=True):
            broken += found
            done += count
            progress.show(done, options.sequences, f'{len(broken)} broken')
            for one in found[:max(0, 10 - len(broken) + len(found))]:
                print(f'sequence {one.seed}: {one.reason}', flush=True)
    print(f'{options.sequences} sequences of {options.messages} messages in {time.monotonic() - begun:.0f} s: '
          f'{len(broken)} broken')
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
