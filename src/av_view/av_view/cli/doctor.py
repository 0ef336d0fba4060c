"""Look at this machine before the first launch: `ros2 run av_view doctor`.

Says what is wrong, and the command that mends it. With --live it guides through two minutes beside the rig that runs, with
claps, a turn, a marker and a walk, and writes a report. Exits with 0 where the rig can start, with 1 where something is an
error, and with 2 for arguments that cannot be used.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from av_bringup.launching import CONFIG
from av_common.arguments import checked, within
from av_view.doctor import program
from av_view.doctor.files import judge_files
from av_view.doctor.finding import Finding
from av_view.doctor.microphones import DIRECTIONS

AREAS = ('files', 'devices', 'microphones', 'camera', 'machine', 'px4')
DEFAULT = AREAS[:-1]
SECONDS = (0.5, 600.0)  # to listen: from a few windows to a walk around the rig


def arguments_of(words: Sequence[str] | None) -> argparse.Namespace:
    """The arguments of the command line."""
    parser = argparse.ArgumentParser(prog='doctor', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--rig', default=str(CONFIG / 'rig.yaml'), help='description of the rig')
    parser.add_argument('--params', action='append', default=[], metavar='FILE', help='parameter file, as params:=')
    parser.add_argument('--only', nargs='+', choices=AREAS, default=DEFAULT, help='areas to look at (default: all but px4)')
    parser.add_argument('--seconds', type=within(*SECONDS), default=3.0, help='to listen and to look')
    parser.add_argument('--clap', type=azimuth, metavar='WHERE',
                        help=f'clap once while it listens: {", ".join(DIRECTIONS)}, or degrees')
    parser.add_argument('--json', action='store_true', help='print JSON')
    live = parser.add_argument_group('a rig that runs')
    live.add_argument('--live', action='store_true', help='test the whole chain step by step')
    live.add_argument('--namespace', default='', metavar='NAME', help='of the rig')
    live.add_argument('--report', type=Path, default=Path('doctor_report.md'), metavar='FILE', help='to write (%(default)s)')
    live.add_argument('--marker-side', type=within(0.0, 10.0), default=0.0, metavar='M',
                      help='of the black square, for the focal length')
    live.add_argument('--distance', type=within(0.1, 100.0), default=1.0, metavar='M',
                      help='of the marker ahead (%(default)g)')
    return parser.parse_args(words)


def azimuth(word: str) -> float:
    """An azimuth (rad) by its name or in degrees. Raises ArgumentTypeError for others."""
    degrees = str(DIRECTIONS.get(word, word))
    return math.radians(checked(degrees, lambda value: abs(value) <= 360.0, f'{", ".join(DIRECTIONS)}, or -360 to 360'))


def look(options: argparse.Namespace) -> list[Finding]:
    """All findings: of a rig that runs those of its steps, else in the order of AREAS."""
    parameter_files = [str(CONFIG / 'rig_params.yaml'), *options.params]
    found, rig = judge_files(options.rig, parameter_files)
    if rig is None:  # whatever cannot be read has no settings for the rest
        return found
    if options.live:
        from av_view.cli.live import test_running  # what it needs of ROS takes a second to import
        return test_running(rig, options)
    checks: dict[str, Callable[[], list[Finding]]] = {
        'files': lambda: found, 'devices': program.devices,
        'microphones': lambda: program.microphones(rig, parameter_files, options.seconds, options.clap),
        'camera': lambda: program.camera(rig, parameter_files, options.seconds),
        'machine': lambda: program.machine(rig, parameter_files), 'px4': program.px4}
    findings: list[Finding] = []
    for area in AREAS:
        if area in options.only and not any(one.area == area and one.level == 'error' for one in findings):
            findings += checks[area]()
    return findings


def main(words: Sequence[str] | None = None) -> None:
    """Entry point."""
    options = arguments_of(words)
    found = look(options)
    errors = sum(finding.level == 'error' for finding in found)
    if options.json:
        print(json.dumps({'errors': errors, 'findings': [asdict(finding) for finding in found]}, indent=1))
    else:
        print(*(finding.lines() for finding in found), sep='\n')
        unknown = sum(finding.level == 'unknown' for finding in found)
        passed = 'the rig can start' if not options.live else f'nothing wrong was found; {unknown} steps could not be judged'
        print(f'{errors} of {len(found)} findings keep the rig from working' if errors else passed)
    sys.exit(1 if errors else 0)
