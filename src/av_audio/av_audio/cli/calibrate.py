"""`ros2 run av_audio calibrate FILE --array ARRAY.yaml --truth TRUTH.csv --output NEW.yaml`: fit an array file.

The source moves through known azimuths while FILE is recorded. TRUTH.csv has the header `time,azimuth_deg` and one row per
instant: s since the beginning of the file, degrees counter-clockwise from x of the array's frame. Azimuths are interpolated
between the rows, along the shorter arc, but not to a row without one. With `--guided` FILE and TRUTH.csv are recorded first:
the program says where to carry a loudspeaker. With `--from-bag BAG` they are extracted from a bag, in which the camera saw
the source.

Exit codes: 0 good, 3 usable beyond 20 degrees from end-fire, 4 do not use (no array file is written), 1 an error.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_audio.calibration import Calibration, Verdict, calibrate, judge, measured_path, outlier_lines, search_array
from av_audio.cli.guided_recording import record
from av_audio.cli.localize import add_localizer_arguments, localize_file, settings_from
from av_audio.device_source import DeviceSource
from av_common.files import MEGABYTE, one_line, read_text, shown
from av_common.microphone_array import MicrophoneArray

COLUMNS = ('time', 'azimuth_deg')
SEPARATORS = ';\t, '
MOST_BYTES = 10 * MEGABYTE    # two hours of azimuths, 100 a second, of 14 bytes
# Places of the loudspeaker in guided mode, in degrees: both ends of the axis, in front and behind.
PLACES_DEG = (*range(-90, 91, 15), 120, 150, 180, -150, -120)


def read_truth(path: str | Path) -> tuple[NDArray, NDArray]:
    """Times (n,) in s and azimuths (n,) in rad, unwrapped, NaN where a field is empty, from a table as people save them.

    Capitals, quotes and spaces around names and numbers, empty lines, other columns and their order do not matter. Fields are
    separated by commas, semicolons, tabs or spaces; where commas do not separate, they may be decimal. No line may have more
    fields than the first.

    Parameters:
        path: the file, in UTF-8, or in UTF-16 with its mark.

    Raises OSError, or ValueError with the file, the line, its value and what is expected.
    """
    lines = [(number, line) for number, line in enumerate(read_text(path, MOST_BYTES).splitlines(), 1)
             if line.strip(' \t,;') and not line.lower().startswith('sep=')]
    head = lines[0][1] if lines else ''
    for separator in SEPARATORS:
        names = [name.casefold() for name in _fields(head, separator)]
        if set(COLUMNS) <= set(names):
            break
    else:
        raise ValueError(f'{path}: the first line is {shown(one_line(head))}, expected the columns {" and ".join(COLUMNS)}')
    rows = []
    for number, line in lines[1:]:
        fields = _fields(line, separator)
        if any(fields[len(names):]):    # decimal commas between commas
            raise ValueError(f'{path}, line {number}: {shown(one_line(line))} has more fields than the first line')
        time, azimuth = (fields[place] if place < len(fields) else '' for place in map(names.index, COLUMNS))
        if separator != ',':
            time, azimuth = time.replace(',', '.'), azimuth.replace(',', '.')
        try:
            rows.append((float(time), float(azimuth or 'nan')))
        except ValueError as error:
            raise ValueError(f'{path}, line {number}: {shown(one_line(line))}, expected numbers in the columns '
                             f'{" and ".join(COLUMNS)}') from error
    if not rows:
        raise ValueError(f'{path} has no rows')
    times, azimuths = np.array(rows).T
    falls = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(falls):
        raise ValueError(f'{path}: time {times[falls[0] + 1]:g} follows {times[falls[0]]:g}, expected times that rise')
    known = np.isfinite(azimuths)
    azimuths[known] = np.unwrap(np.radians(azimuths[known]))
    return times, azimuths


def _fields(line: str, separator: str) -> list[str]:
    if separator == ' ':
        return line.split()
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:  # a field longer than csv takes
        return [line]


def calibrate_file(options: argparse.Namespace) -> tuple[Calibration, NDArray]:
    """Fit the array to a recording; also the times (n,) in s of the estimates. Raises OSError or ValueError."""
    array = MicrophoneArray.load(options.array)
    times, azimuths = read_truth(options.truth)
    estimates = localize_file(options.file, search_array(array), settings_from(options), options.channels, options.ego_noise)
    measured_times, paths = measured_path(array, estimates)
    true_azimuths = np.interp(measured_times, times, azimuths, np.nan, np.nan)
    known = np.isfinite(true_azimuths)
    if len(known) and not known.any():
        raise ValueError(f'{options.truth} tells azimuths at {times[0]:g} to {times[-1]:g} s, {options.file} is heard at '
                         f'{measured_times[0]:g} to {measured_times[-1]:g} s: expected seconds since its beginning')
    return calibrate(array, true_azimuths[known], paths[known]), measured_times[known]


def obtain_recording(options: argparse.Namespace) -> None:
    """Record FILE and the truth, or extract them from a bag, if asked for. Raises OSError or ValueError."""
    if options.guided:
        channels = options.channels or range(MicrophoneArray.load(options.array).channels)
        source = DeviceSource(options.device, options.sample_rate, channels)
        record(source, options.places, options.dwell, options.file, options.truth)
        options.channels = []    # chosen already
    elif options.from_bag:
        # a program of its own, as a robot need not have what reads bags
        command = ['ros2', 'run', 'av_evaluation', 'sight_truth', options.from_bag, '--sound', options.file, '--truth',
                   options.truth, '--array', options.array]
        if subprocess.run(command, check=False).returncode:
            raise ValueError(f'{options.from_bag}: no recording with known azimuths could be extracted (needs av_evaluation)')


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Exits with the code of the verdict, or returns if it is good."""
    options = make_parser().parse_args(arguments)
    try:
        obtain_recording(options)
        calibration, times = calibrate_file(options)
        judgement = judge(calibration)
        for line in outlier_lines(calibration, times):
            print(f'outlier {line}')
        print(f'{calibration.report()}\nverdict       {judgement.words}')
        if judgement.verdict != Verdict.DO_NOT_USE:
            calibration.array.save(options.output, f'Fitted by calibrate to {Path(options.file).name}:\n'
                                                   f'{calibration.report()}\nverdict       {judgement.words}')
            print(f'written to {options.output}')
    except (OSError, ValueError) as error:
        sys.exit(f'calibrate: {error}')
    if judgement.verdict != Verdict.GOOD:
        sys.exit(int(judgement.verdict))


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='calibrate', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('file', help='sound file of two microphones; written with --guided and --from-bag')
    parser.add_argument('--truth', required=True, metavar='CSV', help='azimuths of the source: time, azimuth_deg; likewise')
    parser.add_argument('--output', required=True, metavar='YAML', help='array file to write')
    origin = parser.add_mutually_exclusive_group()
    origin.add_argument('--guided', action='store_true', help='record first: says where to carry a loudspeaker')
    origin.add_argument('--from-bag', metavar='BAG', help='extract the sound, and what the camera saw, from a bag first')
    parser.add_argument('--device', default='', help='guided: name, part of it or index of the device')
    parser.add_argument('--sample-rate', type=int, default=48_000, metavar='HZ',
                        help='guided: sample rate (default: %(default)s)')
    parser.add_argument('--dwell', type=float, default=4.0, metavar='S',
                        help='guided: time at each place (default: %(default)s)')
    parser.add_argument('--places', type=float, nargs='+', default=PLACES_DEG, metavar='DEG', help='guided: the azimuths')
    add_localizer_arguments(parser)
    return parser
