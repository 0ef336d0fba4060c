"""Examples that the rig itself hears in simulated scenes: a drone and a bystander beside a rig that turns to tell them apart.

Directions have the rig's errors there, sources move within the second, and each leaks into the direction of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar
from unittest.mock import patch

import numpy as np
import rendered
from material import RATE, Recording
from numpy.typing import NDArray
from others import bystander_signals
from scipy.signal import resample_poly

from av_audio.drone_classifier import DroneClassifier, Judgement
from av_audio.localizer import LocalizerSettings
from av_common.microphone_array import MicrophoneArray
from av_common.rig import load_rig
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.tracker import MultiTargetTracker
from av_pointing.controller import PointingController, PointingSettings
from av_simulator.config_files import find_config
from av_simulator.scenario import Bystander, Scenario, Target, load_scenario
from av_simulator.sound.source import load_profile
from av_simulator.sound.source_signals import SourceSignal
from av_simulator.sound.stream import CHUNK, Stream
from av_simulator.trajectories import Line, Position, RandomFlight, Static, Trajectory

SCENE = 'alarm'  # scenario whose surroundings are used
DRONES = ('camera_quadrotor', 'cargo_octorotor', 'fixed_wing', 'hexarotor', 'mini_quadrotor', 'racing_quadrotor')
SECONDS = 12.0
DISTANCE_M, BESIDE_M = (4.0, 14.0), (4.0, 60.0)
LOUDER_DB, SNR_DB = (-6.0, 15.0), (5.0, 25.0)  # bystander over drone; drone at 10 m over noise
HALF_WINDOW_S = 0.5 * LocalizerSettings().window_s  # directions are those at the centre of a window
STRIDE = 2  # windows from one example to the next
SAME = 0.1  # cosine within which a direction is that of a source
APART = 0.25  # cosine from which two sources are told apart


@dataclass(frozen=True)
class Played:
    """A sound (n,) at RATE again and again, as a source of the simulator with an RMS pressure of 1 Pa at 1 m."""

    sound: NDArray

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        samples = resample_poly(self.sound, sample_rate, RATE)
        samples = samples / (np.std(samples) + 1e-12)
        return Stream(lambda index: samples[np.arange(index * CHUNK, (index + 1) * CHUNK) % len(samples)])


class _Listener(DroneClassifier):
    """Keeps the features of each direction, with the time of the window and the direction."""

    heard: ClassVar[list[tuple[float, float, NDArray]]] = []

    def __init__(self, array: MicrophoneArray, sample_rate: int, *others: Any) -> None:
        super().__init__(array, sample_rate, *others)
        self._sample_rate, self._added = sample_rate, 0

    def add(self, samples: NDArray[np.float32]) -> None:
        self._added += len(samples)
        super().add(samples)

    def judge(self, directions: Sequence[NDArray], blade_pass_hz: NDArray | None = None) -> list[Judgement]:
        if self._spectra is not None and self._spectra.is_full:
            for q, segment in zip(directions, self._spectra.steered(directions, blade_pass_hz), strict=True):
                self.heard.append((self._added / self._sample_rate - HALF_WINDOW_S, float(q[0]), self._features(segment)))
        return super().judge(directions, blade_pass_hz)


def examples(items: Sequence[Recording], scenes: int, rng: np.random.Generator) -> tuple[NDArray, NDArray, NDArray]:
    """Features (n, f), labels (n,) and kinds (n,).

    Parameters:
        items: recordings; beside them sounds are rendered.
        scenes: number of scenes.
        rng: source of random numbers.
    """
    parts = []
    for _ in range(scenes):
        features, labels = _examples(_drone(items, rng), _bystander(items, rng), rng)
        parts.append((features[::STRIDE], labels[::STRIDE], np.full(len(labels[::STRIDE]), 'simulated scene')))
    features, labels, kinds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return features, labels, kinds


def _drone(items: Sequence[Recording], rng: np.random.Generator) -> SourceSignal:
    """One of the simulator's drones, a rendered or a recorded one."""
    kind = rng.integers(3)
    if kind == 0:
        return load_profile(find_config(str(rng.choice(DRONES)), 'drones')).signal
    return Played(rendered.multirotor(rng) if kind == 1 else _recorded([one for one in items if one.kind == 'drone'], rng))


def _bystander(items: Sequence[Recording], rng: np.random.Generator) -> SourceSignal:
    """A bystander of the simulator, or a recording of anything else than drones."""
    if rng.random() < 0.5:
        return bystander_signals(rng)[rng.integers(4)]
    kind = rng.choice(sorted({one.kind for one in items} - {'drone'}))
    return Played(_recorded([one for one in items if one.kind == kind], rng))


def _recorded(items: Sequence[Recording], rng: np.random.Generator) -> NDArray:
    return items[int(rng.integers(len(items)))].samples


def _examples(drone: SourceSignal, bystander: SourceSignal, rng: np.random.Generator
              ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Features (n, f) of directions in one scene, and whether each is that of the drone (n,).

    Parameters:
        drone, bystander: signals of the simulator.
        rng: source of random numbers.
    """
    scenario = _scene(drone, bystander, rng)
    _Listener.heard.clear()
    run = OfflineRun(scenario, load_rig(find_config('rig')), MultiTargetTracker(), int(rng.integers(1000)),
                     PointingController(PointingSettings()), settings=LocalizerSettings(max_sources=2))
    with patch('av_audio.stage.DroneClassifier', _Listener):
        run.run()
    times = np.array([time for time, _, _ in _Listener.heard])
    heading, own = run.log.heading(times), scenario.rig.trajectory(times)
    left = np.stack([-np.sin(heading), np.cos(heading), np.zeros(len(times))], axis=1)
    away = [each.trajectory(times) - own for each in (scenario.targets[0], scenario.bystanders[0])]
    true = np.array([np.sum(left * v, axis=1) / np.linalg.norm(v, axis=1) for v in away])
    apart = np.abs(true - np.array([q for _, q, _ in _Listener.heard]))
    clear = (apart.min(axis=0) < SAME) & (np.abs(true[0] - true[1]) > APART)
    return np.array([found for _, _, found in _Listener.heard])[clear], (apart[0] < apart[1])[clear]


def _scene(drone: SourceSignal, bystander: SourceSignal, rng: np.random.Generator) -> Scenario:
    scenario = load_scenario(find_config(SCENE, 'scenarios'))
    distance, beside = rng.uniform(*DISTANCE_M), np.exp(rng.uniform(*np.log(BESIDE_M)))
    flight = RandomFlight(_around(distance, rng.uniform(2.0, 6.0), rng), (2.0, 2.5, 0.8), 14.0, int(rng.integers(1000)))
    louder = 20.0 * np.log10(beside / distance) + rng.uniform(*LOUDER_DB)
    level = _level_db(drone) - _level_db(bystander) + louder
    snr = replace(scenario.noise.snr, ratio_db=rng.uniform(*SNR_DB))
    return replace(scenario, duration=SECONDS, seed=int(rng.integers(1000)), targets=(Target(flight, signal=drone),),
                   bystanders=(Bystander(_path(beside, rng), bystander, gain_db=float(np.clip(level, -100.0, 60.0))),),
                   noise=replace(scenario.noise, snr=snr))


def _path(distance: float, rng: np.random.Generator) -> Trajectory:
    """A place, or half as often a straight path that passes it."""
    place = _around(distance, rng.uniform(0.5, max(4.0, 0.5 * distance)), rng)
    if rng.random() < 0.67:
        return Static(place)
    angle, speed = rng.uniform(0.0, 2.0 * np.pi), distance * rng.uniform(0.05, 0.6)
    return Line(place, (speed * np.cos(angle), speed * np.sin(angle), 0.0), 0.5 * SECONDS)


def _around(distance: float, height: float, rng: np.random.Generator) -> tuple[float, float, float]:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return float(distance * np.cos(angle)), float(distance * np.sin(angle)), float(height)


def _level_db(signal: SourceSignal) -> float:
    """Level of the start of a signal, in dB over 1 Pa at 1 m."""
    samples = signal.stream(RATE, [1], lambda times: np.zeros((len(np.atleast_1d(times)), 3))).read(0, 2 * RATE)
    return float(20.0 * np.log10(np.std(samples) + 1e-9))
