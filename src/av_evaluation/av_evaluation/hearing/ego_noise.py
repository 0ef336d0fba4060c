"""A target under the rig's own rotors: directions with and without a recording of the rig, beside methods of others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from av_audio.ego_noise import NoiseRecording
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.free_field import WINDOW_S
from av_evaluation.hearing.peers import PEERS, Srp, azimuths
from av_evaluation.hearing.reach import ARRAYS
from av_evaluation.hearing.signals import RATE, Source, scaled
from av_evaluation.hearing.trials import C, Figure, Locate, Trials, Window, compare, ours, share
from av_simulator.sound.noise import EgoRotors
from av_simulator.sound.rotor import RotorSignal

RECORDING_S, LATER_S = 10.0, 30.0  # known of the rig, and heard afterwards
JITTER = 0.015  # of the speeds
BLADES = 2  # of a rotor
ROTORS = 0.18 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) + np.array([0.0, 0.0, -0.06])  # m, from the array
WIND_DB = -10.0  # noise that microphones do not share, over the target
# Largest share (%) of directions beyond 20 degrees, by microphones and level of own noise over the target in dB.
LIMITS = {(2, 10.0): 3.0, (2, 15.0): 8.0, (8, 20.0): 0.0, (8, 30.0): 40.0}
LEVELS_DB = {2: (-5.0, 0.0, 10.0, 15.0, 20.0), 8: (-5.0, 10.0, 20.0, 30.0)}
SETTINGS = {method: LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S, method=method) for method in ('ml', 'music')}


class Rig:
    """An array amid four rotors, whose speeds wander by 1.5 %.

    Attributes:
        recording: of the rig alone.

    Parameters:
        array: the microphones.
        seed: of the rotors.
    """

    def __init__(self, array: MicrophoneArray, seed: int) -> None:
        self.array, count = array, round(RECORDING_S * RATE)
        speeds_hz = np.random.default_rng(seed).uniform(75.0, 110.0, len(ROTORS))
        rotors = EgoRotors(RotorSignal(speeds_hz.tolist(), BLADES, jitter=JITTER), ROTORS.tolist(), array.positions.tolist())
        sound = rotors.stream(RATE, array.channels, C, [seed]).read(0, round((RECORDING_S + LATER_S) * RATE)).T
        sound = (0.1 / sound.std() * sound).astype(np.float32)
        self.recording, self._later = NoiseRecording(sound[:count], RATE), sound[count:]

    def noise(self, rng: Generator, count: int) -> NDArray:
        """Other sound (n, m) of its rotors, of `count` samples."""
        start = int(rng.integers(len(self._later) - count))
        return self._later[start:start + count]


def window(rng: Generator, rig: Rig, source: Source, level_db: float) -> Window:
    """A target at any azimuth under the rig's own noise.

    Parameters:
        rng: random numbers.
        rig: the rig.
        source: of the target.
        level_db (dB): own noise over the target, from 200 to 4000 Hz.
    """
    azimuth = float(rng.uniform(-np.pi, np.pi))
    target = source(rng, WINDOW_S, -rig.array.positions @ angles_to_direction(azimuth) / C)
    own, wind = rig.noise(rng, len(target)), rng.normal(size=target.shape)
    sound = target + scaled(own, target, level_db) + scaled(wind, target, WIND_DB)
    return Window((0.1 * sound / sound.std()).astype(np.float32), RATE, rig.array, azimuth)


def methods(rig: Rig) -> dict[str, Locate]:
    """Ours and those of others, which have no confidence, by name.

    Parameters:
        rig: the rig, of which those that whiten know a recording of ten seconds.
    """
    return {
        'no recording': ours(Localizer(rig.array, RATE, SETTINGS['ml'])),
        'recording': ours(Localizer(rig.array, RATE, SETTINGS['ml'], rig.recording)),
        'recording, music': ours(Localizer(rig.array, RATE, SETTINGS['music'], rig.recording)),
        **{name: PEERS[name] for name in ('SRP-PHAT', 'MUSIC')},
        'whitened SRP': Srp(rig.array, RATE, angles_to_direction(azimuths(rig.array.channels)), rig.recording).locate}


def ego_noise(count: int, sources: dict[str, Source], rigs: int = 4) -> Iterator[Figure]:
    """Share of directions beyond 20 degrees, mirror images folded, and of confident ones among those of ours.

    Parameters:
        count: windows per level.
        sources: generators of sound by name.
        rigs: number of rigs, whose rotors differ.
    """
    drones = [source for name, source in sources.items() if name != 'flat noise']
    for microphones, levels in LEVELS_DB.items():
        array = next(array for array in ARRAYS if array.channels == microphones)
        equipped = [(rig, methods(rig)) for rig in (Rig(array, seed) for seed in range(rigs))]
        for level_db in levels:
            for name, result in _compared(equipped, count, drones, level_db).items():
                limit = LIMITS.get((microphones, level_db)) if name == 'recording' else None
                yield from _figures(f'{microphones} microphones, own noise {level_db:+.0f} dB, {name}', result, limit)


def _compared(equipped: Sequence[tuple[Rig, dict[str, Locate]]], count: int, drones: list[Source], level_db: float
              ) -> dict[str, Trials]:
    """Results of the methods of each rig at a level of own noise in dB, in `count` windows of all rigs together."""
    rng, rigs = np.random.default_rng(81), len(equipped)
    heard = [window(rng, equipped[k % rigs][0], drones[rng.integers(len(drones))], level_db) for k in range(count)]
    parts = [compare(heard[k::rigs], known) for k, (_, known) in enumerate(equipped[:count])]
    return {name: Trials.together(part[name] for part in parts) for name in parts[0]}


def _figures(title: str, result: Trials, limit: float | None) -> Iterator[Figure]:
    """Of a method; `limit` (%) is that of directions beyond 20 degrees."""
    yield Figure(f'{title}: beyond 20 deg', share(result.far), '%', limit)
    if 'recording' in title:
        sure, astray = result.passed, result.far
        limited = not title.endswith('music') and share(astray) > 10.0
        yield Figure(f'{title}: of those confident', 100.0 * np.sum(sure & astray) / max(astray.sum(), 1), '%',
                     10.0 if limited else None)
        yield Figure(f'{title}: of the others confident', 100.0 * np.sum(sure & ~astray) / max((~astray).sum(), 1), '%')
