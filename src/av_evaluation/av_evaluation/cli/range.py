"""`ros2 run av_evaluation range`: how far drones are heard, beside the Cramer-Rao bound.

A row has the distances up to which in 90 % of windows of 0.5 s the direction is within 5 deg, and the sound is judged to be a
drone's; and that of the bound for directions. Steps are of a factor of 1.4, from 10 to 1280 m; "-" is less than 10 m.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from av_common.arguments import within
from av_evaluation.hearing.reach import ARRAYS, PLACES, Scene
from av_evaluation.runs.program import run_program
from av_simulator.config_files import find_config
from av_simulator.sound.source import load_profile

DRONES = ('mini_quadrotor', 'camera_quadrotor', 'cargo_octorotor')


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog='range', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--drones', nargs='+', default=DRONES, metavar='NAME', help='of config/drones (default: %(default)s)')
    parser.add_argument('--places', type=within(0, len(PLACES) - 1, whole=True), nargs='+', metavar='N',
                        default=range(len(PLACES)),
                        help=', '.join(f'{number}: {place.name}' for number, place in enumerate(PLACES)) + ' (default: all)')
    return run_program(_table, parser, arguments)


def _table(options: argparse.Namespace) -> int:
    signals = {name: load_profile(find_config(name, 'drones')).signal for name in options.drones}
    print(f'{"drone":<18} {"place":<18} {"dB(A)":>5} {"m/s":>4} {"array":<16} {"angle m":>8} {"drone m":>8} {"bound m":>8}')
    for name, signal in signals.items():
        for place in (PLACES[number] for number in options.places):
            for array in ARRAYS:
                reach = Scene(signal, place, array).reach()
                found = ' '.join(f'{distance:>8.0f}' if distance else f'{"-":>8}' for distance in reach)
                where = f'{place.name:<18} {place.ambient_dba:5.0f} {place.wind:4.0f}'
                print(f'{name:<18} {where} {array.name:<16} {found}', flush=True)
    return 0
