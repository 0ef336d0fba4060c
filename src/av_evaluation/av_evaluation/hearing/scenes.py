"""Accuracy with a head between the microphones, in rooms, and with a square of microphones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import signal

from av_audio.calibration import calibrate, measured_path, search_array
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.accuracy import CONFIDENCE_THRESHOLD, PAIR, azimuth_error, rms
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.signals import RATE, Source, add_noise, load_clip, recordings, rotors

SETTINGS = LocalizerSettings(hop_s=0.5)
# Reflections disturb low frequencies most: a higher band is better indoors.
INDOORS = LocalizerSettings(hop_s=0.5, band_hz=(500.0, 8000.0))
EARS = MicrophoneArray(np.array([[0.0, 0.09, 0.0], [0.0, -0.09, 0.0]]), 'kemar')
ROOMS = 60
ROOM_T60_S = 0.4
ROOM_DISTANCE_M = 3.0
SQUARE = MicrophoneArray(0.0325 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]), 'quadrotor_square')


def kemar(data: Path) -> Iterator[Figure]:
    """Drone recordings convolved with measured responses of a head; calibrated at every other azimuth, tested at the rest."""
    azimuths, responses, rate = read_responses(data / 'kemar' / 'mit_kemar_normal_pinna.sofa')
    clips = [signal.resample_poly(load_clip(path), rate // np.gcd(rate, RATE), RATE // np.gcd(rate, RATE))
             for path in sorted((data / 'drone_detection' / 'audio').glob('DRONE_*.flac'))]
    if not clips:
        raise FileNotFoundError(f'no drone recordings in {data}')

    def at_ears(k: int, clip: NDArray, start_s: float) -> NDArray:
        excerpt = clip[int(start_s * rate):int((start_s + 2.0) * rate)]
        return np.stack([signal.fftconvolve(excerpt, response)[:len(excerpt)] for response in responses[k]], axis=1)

    angles: list[float] = []
    paths: list[float] = []
    for k in range(0, len(azimuths), 2):
        for clip in clips:
            localizer = Localizer(search_array(EARS), rate, SETTINGS)
            _, path = measured_path(EARS, localizer.process(at_ears(k, clip, 0.0), 0))
            paths.extend(path)
            angles.extend([azimuths[k]] * len(path))
    calibration = calibrate(EARS, angles, paths)
    results = [(np.degrees(wrap(azimuths[k])), azimuth_error(estimate, azimuths[k]))
               for k in range(1, len(azimuths), 2) for clip in clips
               for estimate in Localizer(calibration.array, rate, SETTINGS).process(at_ears(k, clip, 5.0), 0)]
    truth, errors = np.array(results).T
    yield Figure('KEMAR, |azimuth| <= 60 deg: mean error', float(errors[np.abs(truth) <= 60.0].mean()), 'deg', 1.5)
    yield Figure('KEMAR, all azimuths, folded: mean error', errors.mean(), 'deg', 3.0)
    yield Figure('KEMAR, all azimuths, folded: RMSE', rms(errors), 'deg')
    yield Figure('KEMAR, all azimuths, folded: errors above 20 deg', 100.0 * np.mean(errors > 20.0), '%')
    yield Figure('KEMAR, all azimuths, folded: largest error', errors.max(), 'deg')


def read_responses(path: Path) -> tuple[NDArray, NDArray, int]:
    """Horizontal responses of a SOFA file: azimuths (n,) in rad, responses (n, 2, taps), and their sample rate in Hz.

    Raises FileNotFoundError.
    """
    import h5py
    if not path.is_file():
        raise FileNotFoundError(f'{path} does not exist')
    with h5py.File(path) as file:
        positions = file['SourcePosition'][:]
        level = np.flatnonzero(np.abs(positions[:, 1]) < 0.1)
        order = level[np.argsort(positions[level, 0])]
        return np.radians(positions[order, 0]), file['Data.IR'][order], int(file['Data.SamplingRate'][0])


def room(clips: Path) -> Iterator[Figure]:
    """Median errors in simulated rooms, 3 m from the source, of the localizer and of pyroomacoustics on the same sound."""
    sources: dict[str, Source] = {'white noise': lambda rng, seconds, delays: rng.normal(size=(round(seconds * RATE), 1))}
    if clips.is_dir():
        sources['drone recordings'] = recordings(clips)
    for name, source in sources.items():
        rng = np.random.default_rng(51)
        rooms = [random_room(rng, source) for _ in range(ROOMS)]
        for settings in (SETTINGS, INDOORS):
            yield from room_figures(f'{name}, {settings.band_hz[0]:g}-{settings.band_hz[1]:g} Hz', rooms, settings)


def room_figures(name: str, rooms: list[tuple[float, NDArray]], settings: LocalizerSettings) -> Iterator[Figure]:
    """Median errors of the localizer and of the estimators of pyroomacoustics, in the same windows and band."""
    others = {method: pyroomacoustics_locator(method, settings.band_hz) for method in ('SRP', 'MUSIC')}
    errors: dict[str, list[float]] = {'ours': [], **{method: [] for method in others}}
    covered = []
    for azimuth, sound in rooms:
        for estimate in Localizer(PAIR, RATE, settings).process(sound, 0):
            errors['ours'].append(azimuth_error(estimate, azimuth))
            if estimate.confidence[0] >= CONFIDENCE_THRESHOLD:
                covered.append(errors['ours'][-1] <= 1.64 * np.degrees(np.sqrt(estimate.azimuth_variance[0])))
        for start in range(0, len(sound) - RATE // 2 + 1, RATE // 2):
            for method, locate in others.items():
                found = locate(sound[start:start + RATE // 2])
                folded = abs(np.arcsin(np.sin(found)) - np.arcsin(np.sin(azimuth)))
                errors[method].append(float(np.degrees(folded)))
    medians = {method: float(np.median(values)) for method, values in errors.items()}
    yield Figure(f'{name}, {len(errors["ours"])} windows: median error', medians['ours'], 'deg', 3.0)
    yield Figure(f'{name}: errors within 1.64 sigma above the default confidence', 100.0 * float(np.mean(covered)), '%')
    for method in others:
        yield Figure(f'{name}: pyroomacoustics {method}', medians[method], 'deg')
        yield Figure(f'{name}: ours over pyroomacoustics {method}', medians['ours'] / medians[method], '', 1.0)


def random_room(rng: Generator, source: Source) -> tuple[float, NDArray]:
    """Azimuth in rad and 2 s of sound (n, 2) of the pair in a room of random size, at a random position and orientation.

    Source and microphones are at least 0.5 m from the walls; the reverberation time is ROOM_T60_S by Sabine's formula.
    """
    import pyroomacoustics
    while True:
        size = rng.uniform([6.0, 5.0, 2.8], [10.0, 8.0, 4.0])
        place = rng.uniform([0.5, 0.5, 1.2], size - [0.5, 0.5, 1.2])
        azimuth, yaw = rng.uniform(-np.pi, np.pi, 2)
        position = place + ROOM_DISTANCE_M * angles_to_direction(azimuth + yaw)
        if np.all(position[:2] > 0.5) and np.all(position[:2] < size[:2] - 0.5):
            break
    absorption, order = pyroomacoustics.inverse_sabine(ROOM_T60_S, size)
    shoebox = pyroomacoustics.ShoeBox(size, fs=RATE, materials=pyroomacoustics.Material(absorption), max_order=order)
    shoebox.set_sound_speed(speed_of_sound(20.0))
    shoebox.add_source(position, signal=source(rng, 3.0, np.zeros(1))[:, 0])
    turned = PAIR.positions @ np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    shoebox.add_microphone_array((place + turned).T)
    shoebox.simulate()
    steady = shoebox.mic_array.signals[:, round(0.8 * RATE):round(2.8 * RATE)].T
    return azimuth, add_noise(rng, steady, 30.0)


def pyroomacoustics_locator(method: str, band_hz: tuple[float, float] = SETTINGS.band_hz) -> Callable[[NDArray], float]:
    """An estimator of pyroomacoustics on a grid of 1 degree: a function from windows (n, 2) of the pair to azimuths in rad."""
    import pyroomacoustics
    algorithm = pyroomacoustics.doa.algorithms[method](PAIR.positions[:, :2].T, RATE, 1024, c=speed_of_sound(20.0), num_src=1,
                                                    azimuth=np.radians(np.arange(360.0)))

    def azimuth(window: NDArray) -> float:
        frames = pyroomacoustics.transform.stft.analysis(window.astype(float), 1024, 512)
        algorithm.locate_sources(frames.transpose(2, 1, 0), num_src=1, freq_range=list(band_hz))
        return float(algorithm.azimuth_recon[0])

    return azimuth


def square(count: int) -> Iterator[Figure]:
    """Four microphones: azimuths over the full circle, elevations from 0 to 60 degrees, sound of rotors at 10 dB."""
    rng = np.random.default_rng(52)
    localizer = Localizer(SQUARE, RATE, SETTINGS)
    rows = []
    for _ in range(count):
        azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(0.0, 60.0))
        delays = -SQUARE.positions @ angles_to_direction(azimuth, elevation) / speed_of_sound(20.0)
        window = add_noise(rng, rotors(rng, 0.5, delays), 10.0)
        estimate, = localizer.process(window, localizer.next_sample)
        rows.append((azimuth_error(estimate, azimuth), np.degrees(estimate.elevation[0] - elevation),
                     len(estimate.azimuth), np.degrees(np.sqrt(estimate.azimuth_variance[0]))))
    azimuth_errors, elevation_errors, hypotheses, sigmas = np.array(rows).T
    yield Figure('square of 65 mm, +10 dB: azimuth RMSE', rms(azimuth_errors), 'deg', 2.0)
    yield Figure('square of 65 mm, +10 dB: elevation RMSE', rms(elevation_errors), 'deg', 5.0)
    yield Figure('square of 65 mm: hypotheses', hypotheses.max(), '', 1.0)
    yield Figure('square of 65 mm: azimuth errors within 1.64 sigma', 100.0 * np.mean(azimuth_errors < 1.64 * sigmas), '%')
