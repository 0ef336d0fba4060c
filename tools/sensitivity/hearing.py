"""How well windows of sound are located, by cases: mean logarithms of the density at the true direction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scoring import SOMEWHERE, UNMODELLED, score_of

from av_audio.ego_noise import NoiseRecording
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing import ego_noise, places
from av_evaluation.hearing.reach import ARRAYS
from av_evaluation.hearing.signals import RATE, Source, add_noise, recordings, rotors
from av_evaluation.hearing.trials import C

WINDOW_S = 0.5
PAIR, RING = ARRAYS[0], ARRAYS[-1]
INSTALLED_RAD = math.radians(0.5)  # to which a rig knows how its microphones are turned
FALSE_RAD = math.radians(20.0)  # error of a direction that is none of the sources'


class Case(NamedTuple):
    """Windows of one kind.

    Parameters:
        sound (n, m): samples.
        array: the microphones.
        azimuths (rad): of the sources; of a pair those of either mirror image.
        recording: of the rig alone, None without one.
    """

    sound: NDArray
    array: MicrophoneArray
    azimuths: tuple[float, ...]
    recording: NoiseRecording | None = None
    rate: int = RATE


def cases(count: int, data: Path) -> dict[str, list[Case]]:
    """Windows by name of the case, always the same.

    Parameters:
        count: windows of each case.
        data: folder with recordings and measured responses.
    """
    sources: list[Source] = [rotors, partial(rotors, decay=0.2), recordings(data)]
    indoors, head = places.rooms(np.random.default_rng(1), count, sources), places.Head(data)
    slower = places.rooms(np.random.default_rng(5), count, sources, 16_000)
    fields = {'rooms, +10 dB': (indoors, 10.0, WINDOW_S), 'rooms, +0 dB': (indoors, 0.0, WINDOW_S),
              'rooms, 0.1 s': (indoors, 10.0, 0.1), 'rooms, 0.2 s': (indoors, 10.0, 0.2),
              'rooms, 16 kHz': (slower, 10.0, WINDOW_S), 'head': (head.field(sources, False), 20.0, WINDOW_S),
              'head, 0.1 s': (head.field(sources, False), 20.0, 0.1),
              'head, reflections': (head.field(sources, True), 20.0, WINDOW_S)}
    made: dict[str, Callable[[Generator, Source], Case]] = {
        f'{array.name}, {snr_db:+.0f} dB': partial(_free, array, snr_db)
        for array in ARRAYS for snr_db in (40.0, 10.0, -5.0, -30.0)}
    made |= {f'{array.name}, two sources{title}': partial(_several, array, apart)
             for array in ARRAYS for title, apart in (('', (0.4, 2.0)), (' that are close', (0.2, 0.5)))}
    made |= {'pair that turns, sound that fades': _turning}
    drawn = {}
    for name, make in made.items():
        rng = np.random.default_rng(2)
        drawn[name] = [make(rng, sources[k % len(sources)]) for k in range(count)]
    for name, (field, snr_db, seconds) in fields.items():
        rng = np.random.default_rng(3)
        windows = [field(rng, seconds, snr_db) for _ in range(count)]
        drawn[name] = [Case(one.sound, one.array, (one.azimuth,), rate=one.rate) for one in windows]
    for array, levels_db in ((PAIR, (0.0, 10.0)), (RING, (0.0, 20.0))):
        drawn |= _own_rotors(array, levels_db, sources, count)
    return drawn


def _free(array: MicrophoneArray, snr_db: float, rng: Generator, source: Source) -> Case:
    """A source in noise."""
    azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 0.5) if array.rank > 1 else 0.0
    sound = source(rng, WINDOW_S, -array.positions @ angles_to_direction(azimuth, elevation) / C)
    return Case(add_noise(rng, sound, snr_db), array, (float(azimuth),))


def _several(array: MicrophoneArray, apart: tuple[float, float], rng: Generator, source: Source) -> Case:
    """Two sources, one 3 dB louder, whose projections are least and most so far apart."""
    azimuths = rng.uniform(-np.pi, np.pi, 2)
    while not apart[0] < np.linalg.norm(np.diff(angles_to_direction(azimuths) @ array.basis, axis=0)) < apart[1]:
        azimuths = rng.uniform(-np.pi, np.pi, 2)
    sound = sum((gain * source(rng, WINDOW_S, -array.positions @ angles_to_direction(azimuth) / C)
                 for gain, azimuth in zip((1.0, 0.7), azimuths, strict=True)), np.zeros(1))
    return Case(add_noise(rng, sound, 15.0), array, tuple(azimuths.tolist()))


def _turning(rng: Generator, source: Source) -> Case:
    """A pair that turns by up to 80 deg/s, and a sound that gains or loses 20 dB meanwhile."""
    azimuth, rate, slope = rng.uniform(-1.0, 1.0), rng.uniform(-1.4, 1.4), rng.uniform(-2.0, 2.0)
    steady = source(rng, WINDOW_S + 0.02, np.zeros(1))[:, 0]
    times = np.arange(round(WINDOW_S * RATE)) / RATE - 0.5 * WINDOW_S
    early = PAIR.positions[:, 1] * np.sin(azimuth + rate * times)[:, None] / C
    sound = np.interp(times[:, None] + early, np.arange(len(steady)) / RATE - 0.5 * WINDOW_S - 0.01, steady)
    return Case(add_noise(rng, sound * np.exp(slope * times / WINDOW_S)[:, None], 15.0), PAIR, (float(azimuth),))


def _own_rotors(array: MicrophoneArray, levels_db: tuple[float, ...], sources: list[Source], count: int
                ) -> Iterator[tuple[str, list[Case]]]:
    """Targets under the rig's own rotors with and without a recording of them, and the rig alone."""
    rigs, rng, name = [ego_noise.Rig(array, seed) for seed in (11, 12)], np.random.default_rng(4), array.name
    for level_db in levels_db:
        drawn = [(rigs[k % 2], ego_noise.window(rng, rigs[k % 2], sources[k % len(sources)], level_db)) for k in range(count)]
        title = f'{name}, own rotors {level_db:+.0f} dB'
        yield title, [Case(one.sound, array, (one.azimuth,)) for _, one in drawn]
        yield f'{title}, recording', [Case(one.sound, array, (one.azimuth,), rig.recording) for rig, one in drawn]
    yield f'{name}, own rotors alone, recording', [
        Case(rig.noise(rng, round(WINDOW_S * RATE)), array, (), rig.recording) for rig in (rigs * count)[:count]]


def scores(drawn: dict[str, list[Case]]) -> dict[str, list[float]]:
    """The score of each window: see `score_of`, of what the estimates say of the true directions.

    Parameters:
        drawn: windows by name of the case.
    """
    localizers: dict[tuple, Localizer] = {}

    def locate(case: Case) -> DoaEstimate:
        kind = (case.array.positions.tobytes(), case.rate, len(case.sound), id(case.recording))
        if kind not in localizers:
            seconds = len(case.sound) / case.rate
            settings = LocalizerSettings(window_s=seconds, hop_s=seconds)
            localizers[kind] = Localizer(case.array, case.rate, settings, case.recording)
        return localizers[kind].process(case.sound, localizers[kind].next_sample)[0]

    return {name: [score(locate(case), case.azimuths) for case in windows] for name, windows in drawn.items()}


def score(estimate: DoaEstimate, azimuths: tuple[float, ...]) -> float:
    """Sum over the true azimuths (rad), less what confident directions lose that are none of them.

    Parameters:
        estimate: of a window.
        azimuths (rad): of its sources.
    """
    total, found = 0.0, [one for one in estimate.sources if len(one.azimuth)]
    confidences = [float(one.confidence[0]) for one in found]
    nothing = float(np.prod(np.subtract(1.0, confidences)))
    for azimuth in azimuths:
        densities = [confidence * _density(one, azimuth) for one, confidence in zip(found, confidences, strict=True)]
        total += score_of(sum(densities) + nothing * SOMEWHERE)
    for one, confidence in zip(found, confidences, strict=True):
        if all(np.abs(wrap(one.azimuth - azimuth)).min() > FALSE_RAD for azimuth in azimuths):
            total += math.log(max(1.0 - confidence, UNMODELLED))
    return total


def _density(estimate: DoaEstimate, azimuth: float) -> float:
    """Density at an azimuth (rad) of the closest of the estimate's mirror images."""
    errors = np.abs(wrap(estimate.azimuth - azimuth))
    nearest = int(np.argmin(errors))
    variance = float(estimate.azimuth_variance[nearest]) + INSTALLED_RAD**2
    return math.exp(-0.5 * float(errors[nearest]) ** 2 / variance) / math.sqrt(math.tau * variance)
