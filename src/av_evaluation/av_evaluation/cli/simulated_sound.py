"""`ros2 run av_evaluation simulated_sound [SECTION ...]`: the simulated sound against formulas and other simulators."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence

from av_evaluation.figures import Sections, print_sections
from av_evaluation.simulated_sound import figures

SECTIONS: Sections = {
    'fly_by': figures.fly_by, 'moving_rig': figures.moving_rig, 'air': figures.air, 'room': figures.room,
    'speed': figures.speed, 'peers': figures.peers_fly_by}
PEERS = {'pyroomacoustics': '0.10.1', 'acoular': '26.8', 'pyroadacoustics': '1.1.0'}    # versions used for the comparison


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every figure with its limit; returns 1 when one is missed."""
    parser = argparse.ArgumentParser(prog='simulated_sound', description=__doc__)
    parser.add_argument('sections', nargs='*', metavar='SECTION', help=f'any of {", ".join(SECTIONS)} (default: all)')
    wanted = parser.parse_args(arguments).sections
    missing = [f'{peer}=={version}' for peer, version in PEERS.items() if importlib.util.find_spec(peer) is None]
    if missing:
        print(f'left out, since not installed: pip install {" ".join(missing)}')
    return print_sections(parser, SECTIONS, wanted)


if __name__ == '__main__':
    sys.exit(main())
