"""`ros2 run av_evaluation flying_arrays FOLDER`: directions in the recordings of DREGON or of the SP Cup 2019."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from av_evaluation.hearing.flying_arrays import flying_arrays
from av_evaluation.runs.program import run_program


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; returns 1 with a line that says what is wrong where a file is missing or of another kind."""
    parser = argparse.ArgumentParser(prog='flying_arrays', description=__doc__)
    parser.add_argument('folder', type=Path, help='folder with micPos.txt or coordinates.mat, and the recordings')
    parser.add_argument('--turn', type=float, default=0.0, metavar='DEG',
                        help='turn of the frame of the truth about z from that of the positions; '
                             '180 for the flights of both (default: %(default)s)')
    return run_program(_show, parser, arguments, refused=1)


def _show(options: argparse.Namespace) -> int:
    for figure in flying_arrays(options.folder, options.turn):
        print(figure, flush=True)
    return 0
