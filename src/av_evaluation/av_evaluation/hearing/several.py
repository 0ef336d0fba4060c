"""Several sources in one window: how many are found, how accurate their directions are, and how many are false."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from av_audio.further_sources import MOST_SOURCES
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.accuracy import PAIR, WINDOW_S, rms
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.scenes import SQUARE
from av_evaluation.hearing.signals import RATE, Source, add_noise

SNR_DB = 15.0
APART = 0.4  # least distance between the directions of two sources, projected on the array
FOUND_DEG = 10.0  # a direction with a larger error is false


def several(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """Shares found and false, RMSE and coverage, by array, number of sources and their level below the loudest.

    Parameters:
        count: windows per figure.
        sources: generators of sound by name.
    """
    for name, array in (('pair of 0.2 m', PAIR), ('square of 65 mm', SQUARE)):
        for number, below_db in ((1, 0.0), (2, 0.0), (2, 6.0), (2, 10.0), (3, 0.0)):
            yield from _figures(f'{name}, {number} sources, {0.0 - below_db:g} dB', array, number, below_db, count,
                                list(sources.values()))


def _figures(name: str, array: MicrophoneArray, number: int, below_db: float, count: int, sources: list[Source]
             ) -> Iterator[Figure]:
    rng = np.random.default_rng(71)
    localizer = Localizer(array, RATE, LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S, max_sources=MOST_SOURCES))
    errors, sigmas, false = list[float](), list[float](), 0
    for _ in range(count):
        azimuths = _azimuths(rng, array, number)
        sound = np.zeros((round(WINDOW_S * RATE), array.channels))
        for k, azimuth in enumerate(azimuths):
            delays = -array.positions @ angles_to_direction(azimuth) / speed_of_sound(20.0)
            wave = sources[rng.integers(len(sources))](rng, WINDOW_S, delays)
            sound += wave / wave.std() * 10.0 ** (-(below_db if k else 0.0) / 20.0)
        estimate, = localizer.process(add_noise(rng, sound, SNR_DB), localizer.next_sample)
        found = assigned(estimate, azimuths)
        false += len(estimate.sources) - len(found)
        errors += [error for error, _ in found]
        sigmas += [sigma for _, sigma in found]
    yield Figure(f'{name}: found', 100.0 * len(errors) / (number * count), '%')
    yield Figure(f'{name}: false directions in a window', 100.0 * false / count, '%', 10.0)
    yield Figure(f'{name}: RMSE', rms(np.array(errors)), 'deg')
    yield Figure(f'{name}: errors within 1.64 sigma', 100.0 * float(np.mean(np.array(errors) < 1.64 * np.array(sigmas))), '%')


def assigned(estimate: DoaEstimate, azimuths: NDArray) -> list[tuple[float, float]]:
    """Error and sigma in deg of the direction of each source that is found, the strongest direction first.

    Parameters:
        estimate: directions of a window.
        azimuths (s,) (rad): true azimuths.
    """
    left, found = list(azimuths), list[tuple[float, float]]()
    for source in estimate.sources:
        errors = [float(np.degrees(np.min(np.abs(wrap(source.azimuth - azimuth))))) for azimuth in left]
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
