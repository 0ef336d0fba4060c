"""Public recordings of arrays on flying drones: DREGON, and the data of the IEEE Signal Processing Cup 2019.

Both have eight microphones on one quadrotor at 44.1 kHz, and a loudspeaker's direction in the array's frame. Their layouts, at
any depth, as archives often unpack into a folder of their own name:

    micPos.txt or coordinates.mat          positions (8, 3) in m (`micPos`)
    DREGON_NAME/DREGON_NAME.wav            sound, with
      DREGON_NAME_audiots.mat              `audio_timestamps` of the samples,
      DREGON_NAME_sourcepos.mat            `source_position` with `timestamps`, `azimuth`, `elevation` in deg
    DREGON_*nosource*/DREGON_*.wav         the drone alone
    dev_static/audio/1.wav ...             with SPCUP19_dev_static.mat: `static_azimuth`, `static_elevation` (files, 1) in deg
    dev_flight/audio/1.wav ...             with SPCUP19_dev_flight.mat: `flight_azimuth`, ... (files, frames), every 0.25 s
    [DREGON_]individual_motors_recordings/allMotors_*.wav   the drone alone

Strauss, Mordel, Miguet, Deleforge: DREGON: dataset and methods for UAV-embedded sound source localization, IROS 2018;
Deleforge, Di Carlo, Strauss, Serizel, Marcenaro: Audio-based search and rescue with a drone, IEEE Signal Processing Magazine
36(5), 2019.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from av_audio.ego_noise import NoiseRecording
from av_audio.file_source import read_sound
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.angles import angles_to_direction
from av_common.frames import rotation_from_rpy
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.peers import Srp
from av_evaluation.hearing.trials import CONFIDENCE_THRESHOLD, Figure
from av_evaluation.metrics.metrics import OUTLIER_DEG
from av_evaluation.metrics.tracks import angles_between

FRAME_S, HOP_S = 0.5, 0.25  # of the competition
HIT_DEG = 10.0  # of the competition
SETTINGS = LocalizerSettings(window_s=FRAME_S, hop_s=FRAME_S, elevation_deg=(-90.0, 90.0))
GRID_STEP = 3.0  # deg, of the directions of SRP
MOST_FRAMES = 400  # that are computed, evenly taken: some minutes


class Frame(NamedTuple):
    """Sound of half a second, and where it comes from.

    Parameters:
        sound (n, m): samples.
        rate (Hz): sample rate.
        direction (3,): unit vector to the loudspeaker in the frame of the truth.
    """

    sound: NDArray
    rate: int
    direction: NDArray


@contextmanager
def _naming(*files: Path) -> Iterator[None]:
    """What goes wrong within is raised as ValueError with the names of the files that are read there."""
    try:
        yield
    except (OSError, LookupError, TypeError, ValueError, NotImplementedError, MatReadError) as error:
        raise ValueError(f'{", ".join(map(str, files))}: {error}') from error


def read_array(folder: Path) -> MicrophoneArray:
    """The microphones. Raises FileNotFoundError, or ValueError for positions of another shape."""
    file = next((file for name in ('micPos.txt', 'coordinates.mat') for file in sorted(folder.rglob(name))), None)
    if file is None:
        raise FileNotFoundError(f'{folder} has neither micPos.txt nor coordinates.mat, with the positions of the microphones')
    with _naming(file):
        positions = (np.asarray(loadmat(file)['micPos'], float) if file.suffix == '.mat' else
                     np.loadtxt(file, delimiter=',' if ',' in file.read_text() else None))
    if positions.ndim != 2 or 3 not in positions.shape:
        raise ValueError(f'positions of microphones in {folder} have shape {positions.shape}, expected (m, 3)')
    return MicrophoneArray(positions if positions.shape[1] == 3 else positions.T, folder.name)


def read_frames(folder: Path) -> Iterator[Frame]:
    """All frames whose direction is known. Raises OSError or ValueError that names a file."""
    for truth in sorted(folder.rglob('SPCUP19_*.mat')):
        yield from _competition(truth)
    for sound in sorted(folder.rglob('DREGON_*.wav')):
        truth = sound.with_name(f'{sound.stem}_sourcepos.mat')
        if truth.is_file():
            yield from _dregon(sound, truth)


def read_alone(folder: Path) -> NoiseRecording | None:
    """The drone without loudspeaker, None where there is no such file."""
    files = sorted([*folder.rglob('DREGON_*nosource*.wav'), *folder.rglob('allMotors_*.wav')])
    if not files:
        return None
    sounds = [read_sound(file) for file in files]
    if len({rate for _, rate in sounds}) > 1:
        raise ValueError(f'recordings of the drone alone in {folder} have different sample rates')
    return NoiseRecording(np.concatenate([sound for sound, _ in sounds]), sounds[0][1], str(folder))


def _competition(truth: Path) -> Iterator[Frame]:
    with _naming(truth):
        tables = loadmat(truth)
    angles = [np.atleast_2d(value) for end in ('_azimuth', '_elevation')
              for name, value in tables.items() if name.endswith(end)]
    if len(angles) != 2 or angles[0].shape != angles[1].shape:
        raise ValueError(f'{truth} has no tables of one azimuth and one elevation of equal shape')
    files = len(list((truth.parent / 'audio').glob('*.wav')))
    azimuths, elevations = (table.T if table.shape[1] == files != len(table) else table for table in np.radians(angles))
    for k, (row, column) in enumerate(zip(azimuths, elevations, strict=True)):
        sound, rate = read_sound(truth.parent / 'audio' / f'{k + 1}.wav')
        length = round(FRAME_S * rate)
        starts = [(len(sound) - length) // 2] if len(row) == 1 else [round(HOP_S * j * rate) for j in range(len(row))]
        for start, azimuth, elevation in zip(starts, row, column, strict=True):
            if 0 <= start <= len(sound) - length:
                yield Frame(sound[start:start + length], rate, angles_to_direction(azimuth, elevation))


def _dregon(sound: Path, truth: Path) -> Iterator[Frame]:
    clock = sound.with_name(f'{sound.stem}_audiots.mat')
    with _naming(truth, clock):
        place = loadmat(truth)['source_position']
        stamps, azimuths, elevations = np.broadcast_arrays(*(
            np.ravel(place[name].item()).astype(float) for name in ('timestamps', 'azimuth', 'elevation')))
        begin = float(np.ravel(loadmat(clock)['audio_timestamps'])[0])
    samples, rate = read_sound(sound)
    directions = angles_to_direction(np.radians(azimuths), np.radians(elevations))
    for start in range(0, len(samples) - round(FRAME_S * rate) + 1, round(FRAME_S * rate)):
        away = np.abs(stamps - (begin + start / rate + 0.5 * FRAME_S))
        k = int(np.argmin(away))
        if away[k] <= 0.5 * FRAME_S and np.isfinite(directions[k]).all():
            yield Frame(samples[start:start + round(FRAME_S * rate)], rate, directions[k])


def flying_arrays(folder: Path, turn_deg: float) -> Iterator[Figure]:
    """Directions within 10 degrees, and those that are confident and farther off.

    Parameters:
        folder: of DREGON or of the competition.
        turn_deg (deg): by which the frame of the truth is turned about z from that of the positions.
    """
    array, frames = read_array(folder), list(read_frames(folder))
    if not frames:
        raise FileNotFoundError(f'{folder} has no recording with the direction of its source')
    frames = frames[::max(1, len(frames) // MOST_FRAMES)]
    turned = MicrophoneArray(array.positions @ rotation_from_rpy(0.0, 0.0, np.radians(turn_deg)).T, array.name)
    alone, rate = read_alone(folder), frames[0].rate
    angles = np.meshgrid(np.arange(-180.0, 180.0, GRID_STEP), np.arange(-90.0, 90.1, GRID_STEP))
    grid = angles_to_direction(*np.radians(angles)).reshape(-1, 3)
    for name, recording in (('no recording', None), ('recording of the drone alone', alone)):
        if name != 'no recording' and recording is None:
            continue
        localizer, srp = Localizer(turned, rate, SETTINGS, recording), Srp(turned, rate, grid, recording)
        ours = [_ours(localizer, frame) for frame in frames]
        errors, confident = (np.array(column) for column in zip(*ours, strict=True))
        yield from _figures(f'{name}, ours', errors)
        yield Figure(f'{name}, ours: above the default confidence', 100.0 * float(confident.mean()), '%')
        wrong = 100.0 * float(np.mean(errors[confident] > OUTLIER_DEG)) if confident.any() else 0.0
        yield Figure(f'{name}, ours: of those beyond {OUTLIER_DEG:g} deg', wrong, '%')
        theirs = [angles_between(srp.direction(frame.sound), frame.direction) for frame in frames]
        yield from _figures(f'{name}, SRP-PHAT', np.degrees(theirs))


def _figures(name: str, errors: NDArray) -> Iterator[Figure]:
    yield Figure(f'{name}: within {HIT_DEG:g} deg', 100.0 * float(np.mean(errors <= HIT_DEG)), '%')
    yield Figure(f'{name}: median error', float(np.median(errors)), 'deg')


def _ours(localizer: Localizer, frame: Frame) -> tuple[float, bool]:
    estimate = localizer.process(frame.sound, localizer.next_sample + len(frame.sound))[0]  # a gap: frames are of any time
    directions = angles_to_direction(estimate.azimuth, estimate.elevation)
    error = np.degrees(np.min(angles_between(directions, frame.direction), initial=np.pi))
    return float(error), bool(np.any(estimate.confidence >= CONFIDENCE_THRESHOLD))
