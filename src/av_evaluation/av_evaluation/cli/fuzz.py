"""ros2 run av_evaluation fuzz: senseless messages by the hundred thousand; every command must be fit to be obeyed."""

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
    """Run the sequences; prints what broke, with the seed that breaks it again. Returns 1 when something did."""
    parser = argparse.ArgumentParser(prog='fuzz', description=__doc__)
    parser.add_argument('--sequences', type=int, default=100_000)
    parser.add_argument('--messages', type=int, default=20, help='of a sequence (20)')
    parser.add_argument('--seed', type=int, default=0, help='of the first sequence')
    parser.add_argument('--workers', type=int, default=0, help='parallel processes; 0: one a core')
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
                print(f'sequence {one.seed}: {one.what}', flush=True)
    print(f'{options.sequences} sequences of {options.messages} messages in {time.monotonic() - begun:.0f} s: '
          f'{len(broken)} broken')
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
