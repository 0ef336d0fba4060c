"""`ros2 run av_evaluation export_tracks BAG --out tracks`: the tracks of a bag as a table (CSV) and as features (GeoJSON).

Writes tracks.csv, and tracks.geojsonl with a feature in each line.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from av_bags.errors import BagError
from av_bags.reader import Bag
from av_common.freshness import Instant
from av_reports.contacts import Place, Selection
from av_reports.stage import ReportSettings, ReportStage
from av_reports.track_log import TrackLog

EVERYTHING = Selection(min_existence=0.0, only_drones=False, unresolved=True)
TOPICS = ('target/bearing', 'targets', 'tracks', 'fix')  # what tells of targets, and of where the rig is


def export(bag: Bag, log: TrackLog, settings: ReportSettings, namespace: str = '', rate: float = 5.0) -> int:
    """Write the tracks of a bag; returns how many messages could not be used.

    Parameters:
        bag: where they are read from.
        log: where they are written to.
        settings: which, and where the rig stands.
        namespace: of the recorded rig.
        rate (Hz): most lines of a track and second of the recording.

    Raises BagError where the bag has no tracks, or they were recorded with another definition.
    """
    stage = ReportStage(settings)
    prefix = f'/{namespace.strip("/")}/'.replace('//', '/')
    decoders = {f'{prefix}{name}': bag.decoder(f'{prefix}{name}') for name in TOPICS if f'{prefix}{name}' in bag.topics}
    source = f'{prefix}{"tracks" if settings.positions else "targets"}'
    if source not in decoders:
        raise BagError(f'{bag.path} has no topic {source}')
    refused, written = 0, -math.inf
    for topic, nanoseconds, data in bag.messages(decoders):
        now = Instant(1e-9 * nanoseconds, 1e-9 * nanoseconds)
        try:
            _take(stage, topic.removeprefix(prefix), now)(decoders[topic](data))
        except (ValueError, RuntimeError):
            refused += 1
            continue
        if topic == source and now.ros - written >= 0.99 / rate:
            written = now.ros
            situation = stage.situation(now, 0.0)
            log.write(situation.tracks, situation.place)
    return refused


def _take(stage: ReportStage, name: str, now: Instant) -> Callable[[Any], None]:
    """What the stage does with a message of a topic."""
    return {'target/bearing': stage.on_bearing, 'fix': lambda message: stage.on_fix(message, now),
            'targets': lambda message: stage.on_targets(message, now, 0.0),
            'tracks': lambda message: stage.on_network_tracks(message, now, 0.0)}[name]


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog='export_tracks', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', help='mcap or sqlite3 (.db3), a file or a folder')
    parser.add_argument('--out', required=True, metavar='STEM', type=Path, help='files to write, without their ending')
    parser.add_argument('--positions', action='store_true', help='positions of a network (tracks) instead of bearings')
    parser.add_argument('--place', nargs=3, type=float, metavar=('LATITUDE', 'LONGITUDE', 'ALTITUDE'),
                        help='where the rig stands (deg, deg, m), WGS84; default: as the topic fix says')
    parser.add_argument('--heading', type=float, metavar='DEG', help='true heading of a rig without odometry')
    parser.add_argument('--platform', action='store_true', help="azimuths from the rig's forward direction")
    parser.add_argument('--everything', action='store_true', help='also what is no drone, unlikely, or not resolved')
    parser.add_argument('--rate', type=float, default=5.0, help='most lines of a track a second (Hz)')
    parser.add_argument('--length', type=float, default=500.0, help='of the lines that stand for bearings (m)')
    parser.add_argument('--namespace', default='', help='the namespace of the recorded rig')
    options = parser.parse_args(arguments)
    settings = ReportSettings(
        EVERYTHING if options.everything else Selection(), options.positions, not options.platform,
        Place(*options.place) if options.place else None,
        None if options.heading is None else math.radians(options.heading))
    try:
        with Bag(options.bag) as bag:
            log = TrackLog(options.out, options.length)
            try:
                refused = export(bag, log, settings, options.namespace, options.rate)
            finally:
                log.close()
                if not log.written:     # so that the same command can be repeated with other options
                    for ending in ('csv', 'geojsonl'):
                        options.out.with_name(f'{options.out.name}.{ending}').unlink()
    except (OSError, ValueError) as error:
        sys.exit(f'export_tracks: {error}')
    if not log.written:
        sys.exit('export_tracks: no track is to be written: see --everything, --heading and --platform')
    print(f'{log.written} lines in {options.out}.csv and {options.out}.geojsonl'
          + (f'; {refused} messages could not be used' if refused else ''))
