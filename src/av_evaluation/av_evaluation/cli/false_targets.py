"""`ros2 run av_evaluation false_targets`: what is followed at ordinary places, by `follow_threshold` of fusion_node.

Sounds are the simulator's, heard by the shipped rig's microphones at rest; fog hides the drone. There is a false target each
time that something begins to be followed while no drone is heard.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.arguments import number, whole
from av_common.rig import load_rig
from av_common.track import State
from av_evaluation.experiments.methods import repeat
from av_evaluation.experiments.offline_run import SILENT_DB, OfflineRun
from av_evaluation.metrics.run_log import RunLog, Series
from av_evaluation.runs.program import processes, run_program
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_simulator.config_files import find_config
from av_simulator.scenario import Bystander, Scenario, SourceSignal, Target, Weather
from av_simulator.sound import EngineSignal, Ground, Room, SirenSignal, VoiceSignal
from av_simulator.sound.noise import Noise, Wind
from av_simulator.trajectories import Line, RandomFlight, Static, Vector

THRESHOLDS = (0.5, 0.7, 0.8, 0.9, 0.95)
WITHIN = math.radians(20.0)  # of the drone, or of its mirror image at a pair: the track is the drone's
FOG = 0.8  # 1/m: nothing is seen


def _around(rng: Generator, nearest: float, farthest: float, height: float) -> Vector:
    """A place (m) at a random azimuth and distance (m) from the rig."""
    azimuth, distance = rng.uniform(-math.pi, math.pi), rng.uniform(nearest, farthest)
    return distance * math.cos(azimuth), distance * math.sin(azimuth), height


def _stands(rng: Generator, signal: SourceSignal, nearest: float, farthest: float, height: float = 1.0) -> Bystander:
    return Bystander(Static(_around(rng, nearest, farthest, height)), signal)


def _passes(rng: Generator, signal: SourceSignal, speed: float, seconds: float) -> Bystander:
    """It passes at a random time, to the left or right, at a speed in m/s."""
    x, y = rng.choice([-1.0, 1.0], 2) * rng.uniform([1.0, 5.0], [1.0, 15.0])
    return Bystander(Line((0.0, float(y), 0.6), (speed * float(x), 0.0, 0.0), rng.uniform(0.0, seconds)), signal)


def _wind(rng: Generator, seconds: float) -> dict[str, Any]:
    velocity = rng.uniform(3.0, 9.0) * np.array([*_around(rng, 1.0, 1.0, 0.0)])
    return {'noise': Noise(diffuse_db_spl=30.0, wind=Wind(tuple(map(float, velocity)))), 'ground': Ground('grass')}


def _street(rng: Generator, seconds: float) -> dict[str, Any]:
    cars = [_passes(rng, EngineSignal(rng.uniform(30.0, 110.0), rng.uniform(85.0, 98.0), 0.05, rng.uniform(0.5, 0.95)),
                    rng.uniform(6.0, 18.0), seconds) for _ in range(round(seconds / 8.0))]
    idles = _stands(rng, EngineSignal(rng.uniform(18.0, 40.0), 82.0, 0.02, 0.4), 5.0, 20.0)
    talks = _stands(rng, VoiceSignal(rng.uniform(90.0, 220.0), 70.0), 2.0, 6.0, 1.6)
    siren = _stands(rng, SirenSignal(level_db_spl=105.0), 60.0, 150.0)
    return {'bystanders': (*cars, idles, talks, *([siren] if rng.uniform() < 0.3 else [])), 'ground': Ground('asphalt'),
            'noise': Noise(urban_db_spl=52.0)}


def _garden(rng: Generator, seconds: float) -> dict[str, Any]:
    mower = Bystander(RandomFlight(_around(rng, 8.0, 20.0, 0.4), (4.0, 4.0, 0.0), 20.0, int(rng.integers(1000))),
                      EngineSignal(rng.uniform(22.0, 60.0), rng.uniform(82.0, 94.0), 0.03, rng.uniform(0.2, 0.6)))
    talks = _stands(rng, VoiceSignal(rng.uniform(90.0, 260.0), 68.0), 2.0, 6.0, 1.4)
    return {'bystanders': (mower, talks), 'ground': Ground('grass'),
            'noise': Noise(diffuse_db_spl=35.0, wind=Wind((rng.uniform(1.0, 3.0), 0.0, 0.0)))}


def _workshop(rng: Generator, seconds: float) -> dict[str, Any]:
    def machine(low_hz: float, high_hz: float, noise: float) -> Bystander:
        signal = EngineSignal(rng.uniform(low_hz, high_hz), rng.uniform(72.0, 84.0), rng.uniform(0.001, 0.03), noise)
        return _stands(rng, signal, 2.0, 3.5, 1.2)
    others = machine(8.0, 25.0, 0.3), machine(150.0, 450.0, rng.uniform(0.5, 0.9)), machine(20.0, 60.0, 1.0)
    talks = _stands(rng, VoiceSignal(rng.uniform(90.0, 220.0), 68.0), 1.0, 3.0, 1.6)
    room = Room((-4.0, -4.5, 0.0), (5.0, 4.0, 3.2), (rng.uniform(0.1, 0.4),), 4)
    return {'bystanders': (*(others[k] for k in rng.permutation(3)[:2]), talks), 'room': room,
            'noise': Noise(diffuse_db_spl=40.0)}


PLACES: dict[str, Callable[[Generator, float], dict[str, Any]]] = {
    'wind': _wind, 'street': _street, 'garden': _garden, 'workshop': _workshop}


def scenario(place: str, seed: int, seconds: float, audible: bool) -> Scenario:
    """Some time at a place.

    Parameters:
        place: of PLACES.
        seed: of everything random.
        seconds (s): duration.
        audible: whether a drone is heard; it flies at 3 to 12 m.
    """
    rng = np.random.default_rng([seed, sorted(PLACES).index(place)])
    near, far = ((2.0, 1.0, 2.2), (1.5, 1.5, 0.4)), (_around(rng, 8.0, 8.0, 5.0), (4.0, 4.0, 2.0))
    flight = RandomFlight(*(near if place == 'workshop' else far), period=12.0, seed=seed)
    drone = Target(flight, gain_db=0.0 if audible else SILENT_DB)
    return Scenario(place, (drone,), seconds, seed, weather=Weather(fog=FOG), **PLACES[place](rng, seconds))


def followed(place: str, seed: int, seconds: float, audible: bool) -> NDArray[np.float64]:
    """Figures (t, 3) by thresholds: how often something begins to be followed, shares of time with it, and with the drone.

    The place is simulated once; each threshold has a tracker of its own for what was heard. See `scenario`.
    """
    log = OfflineRun(scenario(place, seed, seconds, audible), load_rig(find_config('rig')), MultiTargetTracker()).run()
    return np.array([_figures(log, repeat(log.events, MultiTargetTracker(TrackerSettings(follow_threshold=threshold))))
                     for threshold in THRESHOLDS])


def _figures(log: RunLog, bearings: Series) -> tuple[float, float, float]:
    is_followed, truth = bearings['state'] != State.NONE, log.true_azimuth(bearings['time'])
    off = np.minimum(abs(wrap(bearings['azimuth'] - truth)), abs(wrap(math.pi - bearings['azimuth'] - truth)))
    begins = is_followed & np.diff(is_followed, prepend=False)
    return float(begins.sum()), float(is_followed.mean()), float(np.mean(is_followed & (off < WITHIN)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog='false_targets', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=number, default=10,
                        help='of each place, without and with a drone (default: %(default)s)')
    parser.add_argument('--seconds', type=number, default=60.0, help='duration of a run (default: %(default)s)')
    parser.add_argument('--seed', type=whole, default=1, help='of the first run (default: %(default)s)')
    parser.add_argument('--places', nargs='+', choices=PLACES, default=list(PLACES), help='(default: all)')
    return run_program(_compare, parser, arguments)


def _compare(options: argparse.Namespace) -> int:
    print(f'{options.runs} runs of {options.seconds:g} s. none: false targets an hour / share of time with one; '
          'drone: share of time in which it is found')
    print(f'{"place":<10} {"":<8}' + ''.join(f'{f"from {threshold:g}":>14}' for threshold in THRESHOLDS))
    with processes() as pool:
        for place in options.places:
            for audible in (False, True):
                run = partial(followed, place, seconds=options.seconds, audible=audible)
                found = list(pool.map(run, range(options.seed, options.seed + options.runs)))
                print(f'{place:<10} {"drone" if audible else "none":<8}' + _row(found, options.seconds, audible), flush=True)
    return 0


def _row(found: Sequence[NDArray], seconds: float, audible: bool) -> str:
    """The columns of a line, of the figures of all runs."""
    begun, shares, drone = np.mean(found, axis=0).T
    if audible:
        return ''.join(f'{share:>14.0%}' for share in drone)
    return ''.join(f'{f"{rate:.0f} / {share:.0%}":>14}' for rate, share in zip(3600.0 / seconds * begun, shares, strict=True))
