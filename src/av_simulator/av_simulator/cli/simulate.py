"""`ros2 run av_simulator simulate SCENARIO --out DIR`: write a scenario as WAV, video, CSV and bag, as fast as possible."""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

from av_common.arguments import positive
from av_simulator.cli.arguments import parser_of, world_of
from av_simulator.config_files import find_config
from av_simulator.offline.files import FileRecorder
from av_simulator.run import steps
from av_simulator.world import World


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = parser_of('simulate', __doc__)
    parser.add_argument('--out', type=Path, required=True, help='folder for the results; created if needed')
    parser.add_argument('--duration', type=positive, help="duration in seconds (default: the scenario's)")
    parser.add_argument('--everything', action='store_true', help='also write PNGs of depth, segmentation and temperature')
    parser.add_argument('--bag', action='store_true', help="also write a rosbag2 (mcap) with the rig's topics")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Write the files. Returns the exit code: 0, 2 for an invalid scenario or folder, 130 after an interrupt."""
    options = parse(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _simulate(world_of(options), find_config(options.scenario, 'scenarios'), options)
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        print(f'simulate: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f'\nsimulate: interrupted; the results so far are in {options.out}', file=sys.stderr)
        return 130
    return 0


def _simulate(world: World, file: Path, options: argparse.Namespace) -> None:
    duration = options.duration or world.scenario.duration
    recorders: list[Any] = []
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        if options.bag:    # first, as it is refused where there is one: then the other files of that run are kept, too
            from av_simulator.offline.bag import BagRecorder  # needs ROS, other outputs do not
            recorders.append(BagRecorder(options.out / 'bag', world))
        if file.resolve() != (options.out / 'scenario.yaml').resolve():    # that of a run is simulated again in its folder
            shutil.copy(file, options.out / 'scenario.yaml')
        recorders.append(FileRecorder(options.out, world, options.image_rate, options.everything))
        began = shown = time.monotonic()
        for step in steps(world, duration, options.image_rate, everything=options.everything):
            for recorder in recorders:
                recorder.write(step)
            if sys.stderr.isatty() and time.monotonic() - shown > 0.5:
                shown = time.monotonic()
                speed = step.end / (shown - began)
                print(f'\r{step.end:6.1f} of {duration:.1f} s, {speed:.1f} x real time', end='', file=sys.stderr)
    finally:
        for recorder in recorders:
            recorder.close()
    took = time.monotonic() - began
    print(f'\r{world.time:.1f} s simulated in {took:.1f} s: {world.time / took:.1f} x real time; see {options.out}')
