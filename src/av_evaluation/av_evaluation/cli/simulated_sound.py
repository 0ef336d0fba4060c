"""`ros2 run av_evaluation simulated_sound [SECTION ...]`: the simulated sound against formulas and pyroomacoustics."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from av_evaluation.figures import Sections, print_sections
from av_evaluation.simulated_sound import figures

SECTIONS: Sections = {'fly_by': figures.fly_by, 'moving_rig': figures.moving_rig, 'air': figures.air, 'room': figures.room,
                      'speed': figures.speed}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every figure with its limit; returns 1 when one is missed."""
    parser = argparse.ArgumentParser(prog='simulated_sound', description=__doc__)
    parser.add_argument('sections', nargs='*', metavar='SECTION', help=f'any of {", ".join(SECTIONS)} (default: all)')
    return print_sections(parser, SECTIONS, parser.parse_args(arguments).sections)


if __name__ == '__main__':
    sys.exit(main())
