"""ros2 run av_evaluation drone_types: which type each acoustic profile of the simulator is taken for, by ear."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat

import numpy as np

from av_evaluation.experiments.drone_types import Flight, fly
from av_simulator.config_files import shipped

NONE = 'none'


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the confusion table."""
    parser = argparse.ArgumentParser(prog='drone_types', description=__doc__)
    parser.add_argument('--flights', type=int, default=10, help='of each type (%(default)s)')
    parser.add_argument('--seconds', type=float, default=8.0, help='of each flight (%(default)s)')
    parser.add_argument('--seed', type=int, default=1, help='of the first flight (%(default)s)')
    parser.add_argument('--workers', type=int, default=0, help='parallel processes; 0: one for each core')
    options = parser.parse_args(arguments)
    profiles = shipped('drones')
    jobs = [(profile, options.seed + flight) for profile in profiles for flight in range(options.flights)]
    with ProcessPoolExecutor(options.workers or os.cpu_count()) as pool:
        flights = list(pool.map(fly, *zip(*jobs, strict=True), repeat(options.seconds)))
    _print(profiles, flights)
    return 0


def _print(profiles: Sequence[str], flights: Sequence[Flight]) -> None:
    columns = [*profiles, NONE]
    print(f'{"is":<18}' + ''.join(f'{name:>18}' for name in columns) + f'{"fundamentals":>14}')
    for profile in profiles:
        own = [flight for flight in flights if flight.profile == profile]
        counts = Counter(flight.named or NONE for flight in own)
        known = [flight.right for flight in own if np.isfinite(flight.right)]
        right = f'{100 * np.mean(known):>12.0f} %' if known else f'{NONE:>14}'
        print(f'{profile:<18}' + ''.join(f'{counts[name]:>18}' for name in columns) + right, flush=True)
    named = sum(flight.named == flight.profile for flight in flights)
    wrong = sum(flight.named not in (flight.profile, '') for flight in flights)
    print(f'of {len(flights)} flights {100 * named / len(flights):.0f} % are named rightly, '
          f'{100 * wrong / len(flights):.0f} % wrongly')


if __name__ == '__main__':
    sys.exit(main())
