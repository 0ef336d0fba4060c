"""A bag for the viewer rerun: `ros2 run av_view bag_to_rerun flight.mcap --out flight.rrd`, then `rerun flight.rrd`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from av_view.rerun_export import export


def main(words: Sequence[str] | None = None) -> None:
    """Write the file. Exits with 1 and a line where there is nothing to read, or no rerun-sdk."""
    parser = argparse.ArgumentParser(prog='bag_to_rerun', description=__doc__)
    parser.add_argument('bag', type=Path, help='mcap or sqlite3 (.db3), a file or a folder')
    parser.add_argument('--out', type=Path, help='file to write (default: the bag\'s name with .rrd)')
    parser.add_argument('--namespace', default='', help='of the recorded rig')
    options = parser.parse_args(words)
    file = options.out or options.bag.with_suffix('.rrd')
    try:
        counts, problems = export(options.bag, file, options.namespace)
    except (ImportError, ValueError, OSError) as error:
        sys.exit(f'bag_to_rerun: {error}')
    for problem in problems:
        print(f'  ! {problem}', file=sys.stderr)
    print(f'{sum(counts.values())} messages of {len(counts)} topics to {file}')
