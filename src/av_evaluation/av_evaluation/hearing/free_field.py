"""Pairs and squares of microphones in the free field: accuracy, calibration of sigma, several sources."""

from __future__ import annotations

from collections.abc import Iterator
from time import process_time

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from std_msgs.msg import Header

from av_audio.drone_classifier import load_model
from av_audio.further_sources import MOST_SOURCES
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.stage import DoaStage
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_common.stamps import to_stamp
from av_evaluation.figures import Figure
from av_evaluation.hearing.places import PAIR, free_field
from av_evaluation.hearing.reach import ARRAYS
from av_evaluation.hearing.signals import BAND_HZ, RATE, Source, add_noise, flat, rotors
from av_evaluation.hearing.trials import C, Trials, compare, error_deg, error_figures, ours, share
from av_evaluation.metrics.statistics import INTERVAL, rmse

SQUARE = MicrophoneArray(0.0325 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]), 'quadrotor_square')
WINDOW_S = 0.5  # the default of doa_node
COST_S = 10.0  # of sound, of which the processor time is measured
SETTINGS = LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S)
APART, FOUND_DEG = 0.4, 10.0  # least distance of two sources, projected on the array; a direction with a larger error is false

Sources = dict[str, Source]


def _trials(seed: int, source: Source, snr_db: float, count: int, azimuths_deg: tuple[float, float] = (-180.0, 180.0)
            ) -> Trials:
    """Results of independent windows of a pair at an SNR in dB, from azimuths drawn uniformly from a range in deg."""
    rng, field = np.random.default_rng(seed), free_field([source], azimuths_deg)
    windows = (field(rng, WINDOW_S, snr_db) for _ in range(count))
    return compare(windows, {'ours': ours(Localizer(PAIR, RATE, SETTINGS))})['ours']


def accuracy(count: int, sources: Sources) -> Iterator[Figure]:
    """RMSE over the full circle with mirror images folded.

    The limits apply to rotors, except to those with equal power per octave at -10 dB: there the Cramer-Rao bound, which assumes
    a known spectrum, is 3 degrees.
    """
    limits = {10.0: 0.6, 0.0: 1.0, -5.0: 2.0, -10.0: 4.0}
    for name, source in sources.items():
        for snr_db in (20.0, *limits):
            result = _trials(31, source, snr_db, count)
            limited = name == 'bright rotors' or (name == 'rotors' and snr_db > -10.0)
            yield from error_figures(f'{name}, {snr_db:+.0f} dB', result,
                                     {'RMSE': limits[snr_db]} if limited and snr_db in limits else {})


def bound(count: int) -> Iterator[Figure]:
    """RMSE over the Cramer-Rao bound (Knapp and Carter, 1976) for a flat source at 30 to 150 degrees from the axis."""
    low, high = BAND_HZ
    for snr_db in (20.0, 10.0, 0.0):
        result = _trials(33, flat, snr_db, count, (-60.0, 60.0))
        snr = 10.0 ** (snr_db / 10.0)
        delay = np.sqrt(3.0 * (1.0 + 2.0 * snr) / (8.0 * np.pi**2 * WINDOW_S * snr**2 * (high**3 - low**3)))
        bounds = C * delay / (PAIR.aperture * np.cos(np.radians(np.linspace(-60.0, 60.0, 1001))))
        ratio = rmse(result.error) / float(np.degrees(rmse(bounds)))
        yield Figure(f'flat source, {snr_db:+.0f} dB: RMSE over Cramer-Rao bound', ratio, '', 1.3)


def sigma(count: int, sources: Sources) -> Iterator[Figure]:
    """Shares of errors within 1.64 sigma and of large errors, among estimates above the default confidence."""
    pooled = []
    for name, source in sources.items():
        for snr_db in (20.0, 10.0, 0.0, -5.0, -10.0):
            pooled.append(_trials(34, source, snr_db, count))
            yield Figure(f'{name}, {snr_db:+.0f} dB: errors within 1.64 sigma', pooled[-1].coverage, '%')
    everything = Trials.together(pooled)
    yield Figure('all sources, +20 to -10 dB: errors within 1.64 sigma', everything.coverage, '%', 97.0, 85.0)
    yield Figure('all sources, +20 to -10 dB: errors above 20 deg', share(everything.far[everything.passed]), '%', 1.0)
    for name, source in sources.items():
        result = _trials(35, source, -20.0, count)
        yield Figure(f'{name}, -20 dB: share above the default confidence', share(result.passed), '%', 2.0)


def square(count: int) -> Iterator[Figure]:
    """Four microphones: azimuths over the full circle, elevations from 0 to 60 degrees, sound of rotors at 10 dB."""
    rng, localizer, rows = np.random.default_rng(52), Localizer(SQUARE, RATE, SETTINGS), []
    for _ in range(count):
        azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(0.0, 60.0))
        window = add_noise(rng, rotors(rng, WINDOW_S, -SQUARE.positions @ angles_to_direction(azimuth, elevation) / C), 10.0)
        estimate, = localizer.process(window, localizer.next_sample)
        rows.append((error_deg(estimate.azimuth, azimuth), np.degrees(estimate.elevation[0] - elevation),
                     len(estimate.azimuth), np.degrees(np.sqrt(estimate.azimuth_variance[0]))))
    azimuth_errors, elevation_errors, hypotheses, sigmas = np.array(rows).T
    yield Figure('square of 65 mm, +10 dB: azimuth RMSE', rmse(azimuth_errors), 'deg', 2.0)
    yield Figure('square of 65 mm, +10 dB: elevation RMSE', rmse(elevation_errors), 'deg', 5.0)
    yield Figure('square of 65 mm: hypotheses', hypotheses.max(), '', 1.0)
    yield Figure('square of 65 mm: azimuth errors within 1.64 sigma', share(azimuth_errors < INTERVAL * sigmas), '%')


def several(count: int, sources: Sources) -> Iterator[Figure]:
    """Shares found and false, RMSE and coverage, by array, number of sources and their level below the loudest."""
    for name, array in (('pair of 0.2 m', PAIR), ('square of 65 mm', SQUARE)):
        for number, below_db in ((1, 0.0), (2, 0.0), (2, 6.0), (2, 10.0), (3, 0.0)):
            yield from _several_figures(f'{name}, {number} sources, {0.0 - below_db:g} dB', array, number, below_db, count,
                                        list(sources.values()))


def cost() -> Iterator[Figure]:
    """Processor time of the stage of doa_node as shipped, with two sources, for one thread with OMP_NUM_THREADS=1."""
    rng, settings = np.random.default_rng(72), LocalizerSettings()
    for array in ARRAYS:
        sound = sum((rotors(rng, COST_S, -array.positions @ angles_to_direction(azimuth) / C) for azimuth in (-0.7, 0.5)),
                    np.zeros((round(COST_S * RATE), array.channels)))
        stage, block = DoaStage(array, settings, drone_model=load_model('')), round(settings.hop_s * RATE)
        frames = [audio_frame(part.astype(np.float32), block * k, RATE, Header(stamp=to_stamp(1.0 + block * k / RATE)))
                  for k, part in enumerate(np.split(add_noise(rng, sound, 15.0), round(COST_S * RATE / block)))]
        begun = process_time()
        for k, frame in enumerate(frames):
            stage.on_audio(frame, 1.0 + block * (k + 1) / RATE)
        yield Figure(f'{array.name}: of a core', 100.0 * (process_time() - begun) / COST_S, '%')


def _several_figures(name: str, array: MicrophoneArray, number: int, below_db: float, count: int, sources: list[Source]
                     ) -> Iterator[Figure]:
    rng = np.random.default_rng(71)
    localizer = Localizer(array, RATE, LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S, max_sources=MOST_SOURCES))
    found, false = list[tuple[float, float]](), 0
    for _ in range(count):
        azimuths, sound = _azimuths(rng, array, number), np.zeros((round(WINDOW_S * RATE), array.channels))
        for k, azimuth in enumerate(azimuths):
            wave = sources[rng.integers(len(sources))](rng, WINDOW_S, -array.positions @ angles_to_direction(azimuth) / C)
            sound += wave / wave.std() * 10.0 ** (-(below_db if k else 0.0) / 20.0)
        estimate, = localizer.process(add_noise(rng, sound, 15.0), localizer.next_sample)
        assigned = _assigned(estimate, azimuths)
        false += len(estimate.sources) - len(assigned)
        found += assigned
    errors, sigmas = np.array(found).T
    yield Figure(f'{name}: found', 100.0 * len(errors) / (number * count), '%')
    yield Figure(f'{name}: false directions in a window', 100.0 * false / count, '%', 10.0)
    yield Figure(f'{name}: RMSE', rmse(errors), 'deg')
    yield Figure(f'{name}: errors within 1.64 sigma', share(errors < INTERVAL * sigmas), '%')


def _assigned(estimate: DoaEstimate, azimuths: NDArray) -> list[tuple[float, float]]:
    """Error and sigma in deg of the direction of each source at azimuths (s,) that is found, the strongest direction first."""
    left, found = list(azimuths), list[tuple[float, float]]()
    for source in estimate.sources:
        errors = [error_deg(source.azimuth, azimuth) for azimuth in left]
        if errors and min(errors) < FOUND_DEG:
            left.pop(int(np.argmin(errors)))
            found.append((min(errors), float(np.degrees(np.sqrt(source.azimuth_variance[0])))))
    return found


def _azimuths(rng: Generator, array: MicrophoneArray, number: int) -> NDArray:
    """Random azimuths (number,) in rad of sources that are apart; for a pair up to 70 degrees from broadside."""
    largest = np.radians(70.0) if array.rank == 1 else np.pi
    while True:
        azimuths = rng.uniform(-largest, largest, number)
        places = angles_to_direction(azimuths) @ array.basis
        if all(np.linalg.norm(a - b) > APART for k, a in enumerate(places) for b in places[:k]):
            return azimuths
