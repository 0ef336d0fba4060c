"""Directions in wind at the microphones, beside methods of others; what of hiss, machines and voices is taken for a drone."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from av_audio.drone_classifier import DroneClassifier, load_model
from av_audio.localizer import Localizer
from av_common.angles import angles_to_direction
from av_evaluation.hearing.free_field import SETTINGS, WINDOW_S
from av_evaluation.hearing.peers import PEERS
from av_evaluation.hearing.places import PAIR
from av_evaluation.hearing.signals import RATE, Source, add_noise, comb, flat, scaled, simulated
from av_evaluation.hearing.trials import C, Figure, Window, compare, error_figures, ours, share
from av_simulator.sound.bystander_signals import EngineSignal, HelicopterSignal, SirenSignal, VoiceSignal
from av_simulator.sound.noise import Wind

WIND_DB = (0.0, 5.0, 10.0, 20.0)  # over the drone, from 200 to 4000 Hz
GALE = Wind((8.0, 0.0, 0.0))  # m/s; levels are set afterwards
POOL_S, HEARD_S = 20.0, 1.2
WHOLE_HZ = (50.0, 16_000.0)  # of noise
OTHERS: dict[str, Source] = {
    **{f'{name} noise': partial(flat, band_hz=WHOLE_HZ, slope=slope)
       for name, slope in (('white', 0.0), ('pink', 0.5), ('brown', 1.0))},
    **{f'comb of {hz:g} Hz': partial(comb, fundamental_hz=hz) for hz in (40.0, 150.0, 230.0)},
    **{name: simulated(sound) for name, sound in (('engine', EngineSignal()), ('helicopter', HelicopterSignal()),
                                                  ('siren', SirenSignal()), ('voice', VoiceSignal()))}}


def wind(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """Errors of a pair's directions in wind, mirror images folded.

    Parameters:
        count: windows per level.
        sources: generators of sound by name.
    """
    drones = [source for name, source in sources.items() if name != 'flat noise']
    gusts = GALE.stream(RATE, PAIR.positions, [91]).read(0, round(POOL_S * RATE)).T
    for over_db in WIND_DB:
        rng, title = np.random.default_rng(92), f'wind {over_db:+.0f} dB over the drone'
        windows = (_windy(rng, drones, gusts, over_db) for _ in range(count))
        results = compare(windows, {'ours': ours(Localizer(PAIR, RATE, SETTINGS)), **PEERS})
        for name, result in results.items():
            yield from error_figures(f'{title}, {name}', result, {'of those beyond 20 deg': 3.0} if name == 'ours' else {})


def _windy(rng: Generator, drones: list[Source], gusts: NDArray, over_db: float) -> Window:
    """A drone in wind (n, 2) that is `over_db` louder."""
    azimuth = float(rng.uniform(-np.pi, np.pi))
    sound = drones[rng.integers(len(drones))](rng, WINDOW_S, -PAIR.positions @ angles_to_direction(azimuth) / C)
    start = int(rng.integers(len(gusts) - len(sound)))
    return Window(add_noise(rng, sound + scaled(gusts[start:start + len(sound)], sound, over_db), 30.0), RATE, PAIR, azimuth)


def hiss(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """Share of single seconds that are judged a drone at even odds, by kind, 10 dB above the noise of a pair.

    Parameters:
        count: seconds per kind.
        sources: generators of sound by name, of which the recordings of drones are used.
    """
    drones = {name: source for name, source in sources.items() if name == 'drone recordings'}
    model = load_model('')
    assert model is not None  # of the shipped one
    for name, source in {**OTHERS, **drones}.items():
        rng, classifier, judged = np.random.default_rng(93), DroneClassifier(PAIR, RATE, C, model), []
        for _ in range(count):
            direction = angles_to_direction(float(rng.uniform(-1.0, 1.0)))
            sound = source(rng, HEARD_S, -PAIR.positions @ direction / C)
            classifier.clear()
            classifier.add(add_noise(rng, sound, 10.0).astype(np.float32))
            judged.append(classifier.judge([PAIR.basis.T @ direction])[0].probability > 0.5)
        yield Figure(f'{name}: seconds judged a drone', share(np.array(judged)), '%')
