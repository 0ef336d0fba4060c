"""ros2 run av_evaluation attack: hostile messages and signals against the running rig."""

from __future__ import annotations

import argparse
import signal
import tempfile
from collections.abc import Sequence
from pathlib import Path

from av_evaluation.attack.program import Attack

KINDS = ('messages', 'no inputs', 'disabled', 'kill', 'stop')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the attacks and print their table; returns 1 where a verdict fails."""
    parser = argparse.ArgumentParser(prog='attack', description=__doc__)
    parser.add_argument('--minutes', type=_positive, default=10.0, help='duration, of one round at least (%(default)g)')
    parser.add_argument('--only', action='append', default=[], choices=KINDS, metavar='ATTACK',
                        help=f'one kind of attack, may be repeated: {", ".join(KINDS)}')
    parser.add_argument('--out', type=Path, help='folder for the table, the data and what the rig prints')
    parser.add_argument('--seed', type=int, default=0, help='of all random values (%(default)s)')
    parser.add_argument('--port-offset', type=int, default=0, help='of the UDP ports, beside another rig')
    parser.add_argument('launch', nargs='*', metavar='NAME:=VALUE', help='further arguments of rig.launch.py')
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    options.out = options.out or Path(tempfile.mkdtemp(prefix='attack_'))
    return Attack(options).run()


def _positive(text: str) -> float:
    if not 0.0 < (value := float(text)) < 1e6:
        raise argparse.ArgumentTypeError(f'{text} is not a number above 0')
    return value
