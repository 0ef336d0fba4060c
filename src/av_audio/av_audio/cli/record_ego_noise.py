"""`ros2 run av_audio record_ego_noise ALONE.wav --array ARRAY.yaml`: record the rig alone, and say what it is good for.

The program says which throttle to set, records, and writes ALONE.wav for the parameter `ego_noise` of doa_node. It moves and
arms nothing: whoever flies or has tied the rig down sets the throttle. `--judge` judges a recording that is there.

Exit codes: 0 the recording buys 3 dB or more, 3 it buys less, 4 the rig is deaf, 1 an error.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from av_audio.cli.guided_recording import record_sound
from av_audio.device_source import DeviceSource
from av_audio.ego_noise import NoiseRecording
from av_audio.ego_verdict import judge
from av_audio.health import ChannelHealth
from av_common.microphone_array import MicrophoneArray

WORTH_DB = 3.0  # of the gain: half of the own noise, or the range times 1.4


def record(options: argparse.Namespace, array: MicrophoneArray) -> None:
    """Record each throttle. Raises OSError or ValueError."""
    source = DeviceSource(options.device, options.sample_rate, options.channels or range(array.channels))
    texts = [f'motors at {share:g} % (tied down on a tripod, propellers on, nobody within their reach)'
             for share in options.throttle] or ['hover, and turn slowly']
    requests = [f'{number} of {len(texts)}: {text}; no other sound; press Enter' for number, text in enumerate(texts, start=1)]
    record_sound(source, requests, options.dwell, options.file)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Exits with the code of the verdict, or returns if the recording is worth having."""
    parser = make_parser()
    options = parser.parse_args(arguments)
    if options.judge and (options.channels or options.throttle or options.device):
        parser.error('--channels, --throttle and --device are for recording; --judge takes the file as doa_node does, with one '
                     'channel for each microphone')
    try:
        array = MicrophoneArray.load(options.array)
        if not options.judge:
            record(options, array)
        recording = NoiseRecording.load(options.file)
        verdict = judge(recording, array)
    except (OSError, ValueError) as error:
        sys.exit(f'record_ego_noise: {error}')
    health = ChannelHealth(array.channels, recording.sample_rate)    # of near sources delays tell nothing
    health.update(recording.samples)
    for fault in health.faults:
        print(f'{options.file}: {fault}', file=sys.stderr)
    print(verdict.words())
    if not np.isfinite(verdict.heard_db):
        sys.exit(4)
    if verdict.gain_db < WORTH_DB:
        sys.exit(3)


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='record_ego_noise', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('file', help='sound file to write, one channel for each microphone')
    parser.add_argument('--array', required=True, metavar='YAML', help='array file')
    parser.add_argument('--judge', action='store_true', help='record nothing, judge the file that is there')
    parser.add_argument('--throttle', type=float, nargs='+', default=[], metavar='PERCENT',
                        help='on a tripod: throttles to set one after the other (default: hover once)')
    parser.add_argument('--dwell', type=float, default=15.0, metavar='S', help='time of each (default: %(default)s)')
    parser.add_argument('--device', default='', help='name, part of it or index of the device')
    parser.add_argument('--channels', type=int, nargs='+', default=[], metavar='N',
                        help='channels of the device in the order of the microphones (default: the first ones)')
    parser.add_argument('--sample-rate', type=int, default=48_000, metavar='HZ', help='sample rate (default: %(default)s)')
    return parser
