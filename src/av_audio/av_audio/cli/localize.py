"""`ros2 run av_audio localize FILE --array ARRAY.yaml`: directions of arrival in a sound file."""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from std_msgs.msg import Header

from av_audio.ego_noise import NoiseRecording
from av_audio.file_source import FRAMES_UNKNOWN, blocks_of, open_sound, pick_channels
from av_audio.localizer import DoaEstimate, LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.methods import DOA_METHODS
from av_audio.spacing import SpacingCheck
from av_audio.stage import DoaStage
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray


def add_localizer_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the localizer to a parser."""
    defaults = LocalizerSettings()
    parser.add_argument('--array', required=True, metavar='YAML',
                        help='array file, such as config/arrays/two_microphones.yaml')
    parser.add_argument('--channels', type=int, nargs='+', default=[], metavar='N',
                        help='channels of the file in the order of the microphones (default: all)')
    parser.add_argument('--method', choices=DOA_METHODS.names, default=defaults.method, help='estimator (default: %(default)s)')
    parser.add_argument('--window', type=float, default=defaults.window_s, metavar='S',
                        help='length of the analysis window in s (default: %(default)s)')
    parser.add_argument('--hop', type=float, default=defaults.hop_s, metavar='S',
                        help='time between estimates in s (default: %(default)s)')
    parser.add_argument('--band', type=float, nargs=2, default=defaults.band_hz, metavar=('LOW', 'HIGH'),
                        help='edges of the band-pass filter in Hz (default: %(default)s)')
    parser.add_argument('--temperature', type=float, default=defaults.temperature_c, metavar='C',
                        help='temperature of the air in degrees Celsius (default: %(default)s)')
    parser.add_argument('--ego-noise', metavar='FILE', help='sound file of the rig alone, whose noise is whitened')


def settings_from(arguments: argparse.Namespace) -> LocalizerSettings:
    """Settings from the options of `add_localizer_arguments`. Raises ValueError."""
    return LocalizerSettings(window_s=arguments.window, hop_s=arguments.hop, band_hz=tuple(arguments.band),
                             method=arguments.method, temperature_c=arguments.temperature)


def localize_file(path: str | Path, array: MicrophoneArray, settings: LocalizerSettings, channels: Sequence[int] = (),
                  ego_noise: str | Path | None = None) -> Iterator[DoaEstimate]:
    """Estimates for a sound file, which is read block by block. Faults of the channels are printed on standard error.

    As in doa_node, channels with severe faults are left out, and directions that need them have no confidence.

    Parameters:
        path: sound file with one channel per microphone.
        array: positions of the microphones.
        settings: settings of the localizer.
        channels: channels of the file in the order of the microphones; empty for all.
        ego_noise: sound file of the rig alone, recorded with the same microphones.

    Raises OSError or ValueError that name what does not fit.
    """
    with open_sound(path) as file:
        picked = pick_channels(file.channels, channels, str(path))
        if len(picked) != array.channels:
            raise ValueError(f'{path} gives {len(picked)} channel(s), but the array {array.name} has {array.channels} '
                             f'microphones; choose with --channels')
        noise = NoiseRecording.load(ego_noise) if ego_noise else None
        if noise is not None:
            noise = noise._replace(samples=noise.samples[:, pick_channels(noise.samples.shape[1], channels, noise.name)])
        stage = DoaStage(array, settings, noise)
        spacing = SpacingCheck(array, file.samplerate, speed_of_sound(settings.temperature_c))
        first_sample = windows = 0
        for whole in blocks_of(file, max(1, file.samplerate // 20)):
            block = whole[:, picked]
            spacing.add(block)
            estimates = stage.estimates(audio_frame(block, first_sample, file.samplerate, Header()))
            yield from estimates
            windows += len(estimates)
            first_sample += len(block)
        heard = first_sample / file.samplerate
        if heard < settings.window_s:
            raise ValueError(f'{path} lasts {heard:.3f} s, less than one window of {settings.window_s:g} s; '
                             'choose with --window')
        if not windows:
            raise ValueError(f'{path} has no window of {settings.window_s:g} s whose samples are all finite numbers')
        if problem := spacing.problem():
            raise ValueError(f'{path} does not fit the array {array.name}: {problem}')
        stated = file.frames if file.frames != FRAMES_UNKNOWN else first_sample
        cut = f'breaks off after {heard:.2f} s' if stated > first_sample + file.samplerate // 20 else ''
        lossy = (f'{stage.without_phases} directions without confidence: a lossy code has removed the phases between the '
                 'channels; record wav or flac') if stage.without_phases else ''
        gaps = f'restarted {stage.restarts} times after samples that are not finite' if stage.restarts else ''
        for problem in filter(None, [cut, spacing.doubt(), *map(str, stage.faults), lossy, gaps]):
            print(f'{path}: {problem}', file=sys.stderr)


def to_record(estimate: DoaEstimate) -> dict[str, Any]:
    """An estimate as a dictionary of numbers, angles in degrees; `sigma_deg` is that of azimuth, None without a direction."""
    variance = float(np.max(estimate.azimuth_variance, initial=0.0))
    return {
        'time': round(estimate.time, 6),
        'azimuth_deg': np.degrees(estimate.azimuth).round(3).tolist(),
        'elevation_deg': np.degrees(estimate.elevation).round(3).tolist(),
        'sigma_deg': round(min(180.0, float(np.degrees(np.sqrt(variance)))), 6) if len(estimate.azimuth) else None,
        'confidence': round(float(np.max(estimate.confidence, initial=0.0)), 4),
    }


def write_csv(records: list[dict[str, Any]]) -> None:
    """One row per window, one pair of columns per hypothesis."""
    count = max((len(record['azimuth_deg']) for record in records), default=0)
    writer = csv.writer(sys.stdout, lineterminator='\n')
    writer.writerow(['time', *(f'azimuth_deg_{k}' for k in range(count)), *(f'elevation_deg_{k}' for k in range(count)),
                     'sigma_deg', 'confidence'])
    for record in records:
        filler = [''] * (count - len(record['azimuth_deg']))
        sigma = '' if record['sigma_deg'] is None else record['sigma_deg']
        writer.writerow([record['time'], *record['azimuth_deg'], *filler, *record['elevation_deg'], *filler, sigma,
                         record['confidence']])


def write_table(records: list[dict[str, Any]]) -> None:
    """A table to read: azimuths and elevations of the hypotheses side by side."""
    print(f'{"time s":>8} {"azimuth deg":>22} {"elevation deg":>22} {"sigma":>7} {"confidence":>10}')
    for record in records:
        azimuth = ' or '.join(f'{value:.1f}' for value in record['azimuth_deg']) or 'silent'
        elevation = ' or '.join(f'{value:.1f}' for value in dict.fromkeys(record['elevation_deg']))
        sigma = '' if record['sigma_deg'] is None else f'{record["sigma_deg"]:.2f}'
        print(f'{record["time"]:8.3f} {azimuth:>22} {elevation:>22} {sigma:>7} {record["confidence"]:10.2f}')


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog='localize', description='Directions of arrival in a sound file.')
    parser.add_argument('file', help='sound file with one channel per microphone')
    add_localizer_arguments(parser)
    output = parser.add_mutually_exclusive_group()
    output.add_argument('--json', action='store_true', help='print a list of objects')
    output.add_argument('--csv', action='store_true', help='print comma separated values')
    options = parser.parse_args(arguments)
    try:
        array = MicrophoneArray.load(options.array)
        records = [to_record(estimate) for estimate in
                   localize_file(options.file, array, settings_from(options), options.channels, options.ego_noise)]
    except (OSError, ValueError) as error:
        sys.exit(f'localize: {error}')
    if options.json:
        json.dump(records, sys.stdout, indent=1)
        print()
    elif options.csv:
        write_csv(records)
    else:
        write_table(records)
