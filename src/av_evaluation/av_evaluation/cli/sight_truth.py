"""ros2 run av_evaluation sight_truth BAG --sound FILE --truth FILE --array FILE: sound of a bag, and where its source was seen.

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
from std_msgs.msg import Header

from av_audio.messages import samples_of
from av_bags import topics as names
from av_bags.feed import Feed
from av_bags.reader import Bag
from av_bags.topics import find_topics
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_common.stamps import to_seconds
from av_evaluation.metrics.metrics import TAU
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_fusion.measurement.measurements import CameraMeasurement

LONGEST_GAP_S = 1.0    # between images of the target, over which its azimuth is interpolated
LONGEST_SOUND_S = 3600.0  # an hour at 48 kHz takes 0.7 GB a channel

Sighting = tuple[float, NDArray]    # time (s), unit vector (3,) in the body; NaN in the middle of a gap


def seen(replay: Replay) -> list[Sighting]:
    """Where the target of a bag was seen, and when. Raises ValueError for none.

    Parameters:
        replay: of the bag, which keeps its events.
    """
    found: list[Sighting] = []
    for event in replay.run().events:
        if not isinstance(event, CameraMeasurement) or (best := event.best) is None or best.score < TAU:
            continue
        if found and event.time - found[-1][0] > LONGEST_GAP_S:
            found.append((0.5 * (event.time + found[-1][0]), np.full(3, np.nan)))
        if not found or event.time > found[-1][0]:
            found.append((event.time, angles_to_direction(best.azimuth, best.elevation)))
    if not found:
        raise ValueError(f'no target is seen with a score of {TAU} or more')
    return found


def azimuths_at(array: MicrophoneArray, directions: NDArray) -> NDArray:
    """Azimuths (n,) in deg of directions (n, 3) in the frame of an array, on the cone about its first axis."""
    axis = array.basis[:, 0]
    side = np.where(axis[0] * directions[:, 1] - axis[1] * directions[:, 0] >= 0.0, 1.0, -1.0)
    return np.degrees(np.arctan2(axis[1], axis[0]) + side * np.arccos(np.clip(directions @ axis, -1.0, 1.0)))


def heard(bag: Bag) -> tuple[NDArray, int, Header]:
    """Sound (n, channels) with zeros in gaps, its sample rate, and the header of its first sample.

    Raises ValueError when there is none, more than LONGEST_SOUND_S, or more than one recording.
    """
    found = find_topics(bag, names.KINDS)
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
    return sound, int(first.sample_rate), first.header


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog='sight_truth', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', help='mcap or sqlite3 (.db3), a file or a folder')
    parser.add_argument('--sound', required=True, metavar='FILE', help='sound file to write')
    parser.add_argument('--truth', required=True, metavar='CSV', help='table of times and azimuths to write')
    parser.add_argument('--array', required=True, metavar='FILE', help='array file of the microphones')
    options = parser.parse_args(arguments)
    try:
        array = MicrophoneArray.load(options.array)
        with Bag(options.bag) as bag:
            replay = Replay(bag, ReplaySettings(stage='doa'), keeps_events=True)
            times, directions = zip(*seen(replay), strict=True)
            sound, rate, begin = heard(bag)
        rotation = replay.frames.fixed(begin.frame_id)    # the frames of the bag go before the description
        if rotation is None:
            raise ValueError(f'no transform from {begin.frame_id!r}, the frame of the sound, to the body')
        azimuths = azimuths_at(array, np.array(directions) @ rotation)
        soundfile.write(options.sound, sound, rate, subtype='FLOAT')
        with Path(options.truth).open('w', newline='', encoding='utf-8') as file:
            table = csv.writer(file)
            table.writerow(['time', 'azimuth_deg'])
            table.writerows([f'{time - to_seconds(begin.stamp):.6f}', '' if np.isnan(azimuth) else f'{azimuth:.4f}']
                            for time, azimuth in zip(times, azimuths, strict=True))
    except (OSError, ValueError) as error:
        sys.exit(f'sight_truth: {error}')
    print(f'{np.isfinite(azimuths).sum()} images of the target, {len(sound) / rate:.1f} s of sound')
