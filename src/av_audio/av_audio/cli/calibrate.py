"""`ros2 run av_audio calibrate FILE --array ARRAY.yaml --truth TRUTH.csv --output NEW.yaml`: fit an array file.

The source moves through known azimuths while FILE is recorded. TRUTH.csv has the header `time,azimuth_deg` and one row per
instant: s since the beginning of the file, degrees counter-clockwise from x of the array's frame. Azimuths are interpolated
between the rows, along the shorter arc.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_audio.calibration import Calibration, calibrate, measured_path, search_array
from av_audio.cli.localize import add_localizer_arguments, localize_file, settings_from
from av_common.files import MEGABYTE, one_line, read_text
from av_common.microphone_array import MicrophoneArray

MOST_BYTES = 10 * MEGABYTE


def read_truth(path: str | Path) -> tuple[NDArray, NDArray]:
    """Times (n,) in s and azimuths (n,) in rad, unwrapped. Raises OSError or ValueError that names the file."""
    lines = read_text(path, MOST_BYTES).splitlines()
    try:
        rows = [(float(row['time']), float(row['azimuth_deg'])) for row in csv.DictReader(lines)]
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{path}: expected columns time and azimuth_deg, numbers in each row ({one_line(error)})') from error
    if not rows:
        raise ValueError(f'{path} has no rows')
    times, azimuths = np.array(rows).T
    if np.any(np.diff(times) <= 0.0):
        raise ValueError(f'{path}: times must rise')
    return times, np.unwrap(np.radians(azimuths))


def calibrate_file(options: argparse.Namespace) -> Calibration:
    """Fit the array to a recording. Raises OSError or ValueError that name what does not fit."""
    array = MicrophoneArray.load(options.array)
    times, azimuths = read_truth(options.truth)
    estimates = localize_file(options.file, search_array(array), settings_from(options), options.channels, sys.stderr.isatty(),
                              options.ego_noise)
    measured_times, paths = measured_path(array, estimates)
    known = (measured_times >= times[0]) & (measured_times <= times[-1])
    return calibrate(array, np.interp(measured_times[known], times, azimuths), paths[known])


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog='calibrate', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('file', help='sound file of two microphones')
    parser.add_argument('--truth', required=True, metavar='CSV', help='azimuths of the source: time, azimuth_deg')
    parser.add_argument('--output', required=True, metavar='YAML', help='array file to write')
    add_localizer_arguments(parser)
    options = parser.parse_args(arguments)
    try:
        calibration = calibrate_file(options)
        calibration.array.save(options.output, f'Fitted by calibrate to {Path(options.file).name}:\n{calibration.report()}')
    except (OSError, ValueError) as error:
        sys.exit(f'calibrate: {error}')
    print(calibration.report())
    print(f'written to {options.output}')
