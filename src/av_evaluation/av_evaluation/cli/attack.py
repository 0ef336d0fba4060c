"""ros2 run av_evaluation attack: hostile messages, datagrams, clocks, requests and signals against the running rig."""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from pathlib import Path

from av_evaluation import namespaces
from av_evaluation.attack.attacks import ATTACKS, PROCESS_ATTACKS
from av_evaluation.attack.program import Options, attack


def main(arguments: list[str] | None = None) -> int:
    """Run the attacks and print their table; returns 1 where a verdict fails."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog='attack', description=__doc__)
    parser.add_argument('--minutes', type=float, default=60.0,
                        help='duration; 60 send 100,000 messages to each topic and datagrams to each port (%(default)s)')
    parser.add_argument('--messages', type=int, default=0,
                        help='to send to each topic, and datagrams to each port (100,000 an hour); a verdict of its own')
    parser.add_argument('--only', action='append', default=[], choices=[*ATTACKS, *PROCESS_ATTACKS], metavar='ATTACK',
                        help=f'one kind of attack, may be repeated: {", ".join([*ATTACKS, *PROCESS_ATTACKS])}')
    parser.add_argument('--out', type=Path, help='folder for the table, the data and what the rig prints')
    parser.add_argument('--seed', type=int, default=0, help='of all random values (%(default)s)')
    parser.add_argument('--port-offset', type=int, default=0, help='of the UDP ports, where the machine gives no network')
    parser.add_argument('--here', action='store_true', help='attack in this network instead of one made for it')
    parser.add_argument('launch', nargs='*', metavar='NAME:=VALUE', help='further arguments of rig.launch.py')
    options = parser.parse_args(given)
    if not options.here and not namespaces.is_inside():
        reason = namespaces.enter('av_evaluation.cli.attack', given)
        print(f'attack: no network of its own, and no other host ({reason}): attacking in this one', file=sys.stderr)
    if namespaces.is_inside():
        namespaces.prepare_loopback()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    out = options.out or Path(tempfile.mkdtemp(prefix='attack_'))
    return attack(Options(options.minutes, out, tuple(options.only), options.seed, options.port_offset, tuple(options.launch),
                          options.messages))


if __name__ == '__main__':
    sys.exit(main())
