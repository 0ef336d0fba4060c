"""`ros2 run av_evaluation simulated_sound`: comparison of the simulated sound with formulas and other simulators."""

from __future__ import annotations

import argparse
import importlib.util
import sys

from av_evaluation.simulated_sound import figures

SECTIONS = {
    'fly_by': figures.fly_by, 'moving_rig': figures.moving_rig, 'air': figures.air, 'room': figures.room,
    'speed': figures.speed, 'peers': figures.peers_fly_by,
}
PEERS = {'pyroomacoustics': '0.10.1', 'acoular': '26.8', 'pyroadacoustics': '1.1.0'}    # versions used for the comparison


def main(arguments: list[str] | None = None) -> int:
    """Print every figure with its limit. Returns the exit code: 0 if all limits are met, else 1."""
    parser = argparse.ArgumentParser(prog='simulated_sound', description=__doc__)
    parser.add_argument('sections', nargs='*', metavar='section', help=f'one or more of {", ".join(SECTIONS)} (default: all)')
    wanted = parser.parse_args(arguments).sections or list(SECTIONS)
    if unknown := [name for name in wanted if name not in SECTIONS]:
        parser.error(f'section is {unknown[0]!r}, expected one of {", ".join(SECTIONS)}')
    missing = [peer for peer in PEERS if importlib.util.find_spec(peer) is None]
    if missing:
        wanted_versions = ' '.join(f'{peer}=={PEERS[peer]}' for peer in missing)
        print(f'Omitted, since not installed: {", ".join(missing)} (pip install {wanted_versions})')
    held = True
    for name in wanted:
        print(f'\n{name}: {SECTIONS[name].__doc__}')
        for figure in SECTIONS[name]():
            held &= figure.holds
            print(_line(figure), flush=True)
    return 0 if held else 1


def _line(figure: figures.Figure) -> str:
    limits = [f'{sign} {limit:.4g}' for sign, limit in (('<=', figure.most), ('>=', figure.least)) if limit is not None]
    verdict = ('holds' if figure.holds else 'MISSED') if limits else ''
    return f'  {figure.name:<68}{figure.value:>12.4g} {figure.unit:<4}{", ".join(limits):<22}{verdict}'.rstrip()


if __name__ == '__main__':
    sys.exit(main())
