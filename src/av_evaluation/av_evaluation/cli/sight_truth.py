"""`ros2 run av_evaluation sight_truth BAG --sound FILE.wav --truth FILE.csv`: sound, and where the camera saw its source.

For `ros2 run av_audio calibrate`, which starts this program with `--from-bag`. One target must be in the picture, and must
be what is heard. Azimuths are those in the array's frame, on the horizontal plane of the cone on which the target was; they
are left empty where it was not seen for more than a second.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray

from av_audio.messages import samples_of
from av_bags import topics as names
from av_bags.feed import Feed
from av_bags.reader import Bag
from av_bags.topics import find_topics, parse_remappings
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_common.rig import Rig, load_rig
from av_common.stamps import to_seconds
from av_evaluation.metrics.metrics import TAU
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_fusion.measurement.measurements import CameraMeasurement
from av_simulator.config_files import find_config

LONGEST_GAP_S = 1.0    # between images of the target, over which its azimuth is interpolated
LONGEST_SOUND_S = 3600.0  # an hour at 48 kHz takes 0.7 GB a channel

Row = tuple[float, float]    # time (s), azimuth (deg)


def seen(bag: Bag, settings: ReplaySettings, rig: Rig, array: MicrophoneArray) -> list[Row]:
    """Capture times and azimuths at which the target was seen; NaN in gaps. Raises BagError or ValueError."""
    log = Replay(bag, settings, keeps_events=True).run()
    rotation = rig.array.mount.rotation
    axis = array.basis[:, 0]
    turn = float(np.arctan2(axis[1], axis[0]))
    rows: list[Row] = []
    for event in log.events:
        if not isinstance(event, CameraMeasurement):
            continue
        best = event.best
        if best is None or best.score < TAU:
            continue
        direction = rotation.T @ angles_to_direction(best.azimuth, best.elevation)
        side = 1.0 if axis[0] * direction[1] - axis[1] * direction[0] >= 0.0 else -1.0
        azimuth = float(np.degrees(turn + side * np.arccos(np.clip(axis @ direction, -1.0, 1.0))))
        if rows and event.time - rows[-1][0] > LONGEST_GAP_S:
            rows.append((0.5 * (event.time + rows[-1][0]), np.nan))
        if not rows or event.time > rows[-1][0]:
            rows.append((event.time, azimuth))
    if not rows:
        raise ValueError(f'{bag.path}: no target is seen with a score of {TAU} or more')
    return rows


def heard(bag: Bag, settings: ReplaySettings) -> tuple[NDArray, int, float]:
    """Sound (n, channels) with zeros in gaps, its sample rate, and the capture time in s of its first sample.

    Raises ValueError when there is none, more than LONGEST_SOUND_S, or more than one recording.
    """
    found = find_topics(bag, names.KINDS, settings.remappings, settings.namespace)
    if names.AUDIO not in found:
        raise ValueError(f'{bag.path}: {found.missing[names.AUDIO]}')
    records = list(Feed(bag, {names.AUDIO: found.topics[names.AUDIO]}))
    if not records:
        raise ValueError(f'{bag.path}: no sound')
    frames = [record.message for record in records]
    if records[-1].segment or any(after.first_sample < before.first_sample for before, after in pairwise(frames)):
        raise ValueError(f'{bag.path}: the sound begins anew, expected one recording without a break')
    first, last = frames[0], frames[-1]
    length = int(last.first_sample) - int(first.first_sample) + len(last.samples) // max(1, last.channels)
    if not 0 < length <= LONGEST_SOUND_S * first.sample_rate:
        raise ValueError(f'{bag.path}: sound of {length / max(1, first.sample_rate):.0f} s, expected up to {LONGEST_SOUND_S:g}')
    sound = np.zeros((length, first.channels), np.float32)
    for frame in frames:
        start = int(frame.first_sample) - int(first.first_sample)
        if (frame.channels, frame.sample_rate) == (first.channels, first.sample_rate):
            block = samples_of(frame)
            sound[start:start + len(block)] = block[:length - start]
    return sound, int(first.sample_rate), to_seconds(first.header.stamp)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog='sight_truth', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', help='mcap or sqlite3 (.db3), a file or a folder')
    parser.add_argument('--sound', required=True, metavar='FILE', help='sound file to write')
    parser.add_argument('--truth', required=True, metavar='CSV', help='table of times and azimuths to write')
    parser.add_argument('--rig', default='', metavar='FILE', help="the rig's description; default: config/rig.yaml")
    parser.add_argument('--array', default='', metavar='FILE', help="an array file other than the rig's")
    parser.add_argument('--remap', nargs='+', action='extend', default=[], metavar='NAME:=TOPIC', help='topics of other names')
    parser.add_argument('--namespace', default='', help='the namespace of the recorded rig')
    options = parser.parse_args(arguments)
    try:
        settings = ReplaySettings(stage='doa', rig=options.rig, array=options.array, namespace=options.namespace,
                                  remappings=parse_remappings(options.remap))
        rig = load_rig(options.rig or find_config('rig'))
        array = MicrophoneArray.load(options.array) if options.array else rig.array.geometry
        with Bag(options.bag) as bag:
            rows = seen(bag, settings, rig, array)
            sound, rate, begin = heard(bag, settings)
        soundfile.write(options.sound, sound, rate, subtype='FLOAT')
        with Path(options.truth).open('w', newline='', encoding='utf-8') as file:
            table = csv.writer(file)
            table.writerow(['time', 'azimuth_deg'])
            table.writerows([f'{time - begin:.6f}', '' if np.isnan(azimuth) else f'{azimuth:.4f}'] for time, azimuth in rows)
    except (OSError, ValueError) as error:
        sys.exit(f'sight_truth: {error}')
    print(f'{np.isfinite([azimuth for _, azimuth in rows]).sum()} images of the target, {len(sound) / rate:.1f} s of sound')
