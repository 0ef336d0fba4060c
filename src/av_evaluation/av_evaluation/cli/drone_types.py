"""ros2 run av_evaluation drone_types: which type each acoustic profile of the simulator is taken for, by ear."""

from __future__ import annotations

import argparse
import math
import os
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_evaluation.experiments.measurement_simulation import blade_pass_of
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.settings import types_of
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_simulator.config_files import find_config, shipped
from av_simulator.profile import Profile
from av_simulator.scenario import Scenario, Target, Weather
from av_simulator.sound.noise import Noise, Snr
from av_simulator.trajectories import RandomFlight

NONE = 'none'


NEAREST_M, FARTHEST_M, HEIGHT_M = 6.0, 20.0, 5.0
SNR_DB = 0.0, 20.0  # between which the ratio at 10 m is drawn
FOG = 0.8  # 1/m, so that nothing is seen


@dataclass(frozen=True)
class Flight:
    """What was heard of one flight.

    Parameters:
        profile: name of the drone's acoustic profile.
        named: type that its track was given at last; empty for none.
        fundamentals (n,) (Hz): measured in its course, NaN where none.
        blade_pass (Hz): in level flight.
    """

    profile: str
    named: str
    fundamentals: NDArray[np.float64]
    blade_pass: float

    @property
    def right(self) -> float:
        """Share of the fundamentals that are within 15 % of the blade-pass frequency; NaN without any."""
        known = self.fundamentals[np.isfinite(self.fundamentals)]
        return float(np.mean(np.abs(np.log(known / self.blade_pass)) < 0.15)) if known.size else math.nan


def fly(profile: str, seed: int, duration: float) -> Flight:
    """Render one flight of a drone at a random place, in random noise, and name it.

    Parameters:
        profile: name of its acoustic profile.
        seed: of everything random.
        duration (s): of the flight.
    """
    random = np.random.default_rng(seed)
    azimuth, distance = random.uniform(-math.pi, math.pi), random.uniform(NEAREST_M, FARTHEST_M)
    centre = (distance * math.cos(azimuth), distance * math.sin(azimuth), HEIGHT_M)
    scenario = Scenario(
        'drone_types', (Target(RandomFlight(centre, (3.0, 3.0, 1.0), 8.0, seed), profile, drone=profile),), duration, seed,
        weather=Weather(fog=Profile(values=(FOG,))), noise=Noise(snr=Snr(float(random.uniform(*SNR_DB)))))
    tracker = MultiTargetTracker(TrackerSettings(types=types_of(
        node_parameters('av_fusion', 'fusion_node').types)))
    run = OfflineRun(scenario, load_rig(find_config('rig')), tracker)
    run.run()
    targets = tracker.targets(tracker.estimate(run.world.time)).targets
    best = max(targets, key=lambda target: target.existence, default=None)
    heard = [event.fundamental for event in run.rig.record.events if isinstance(event, DoaMeasurement)]
    return Flight(profile, best.kind if best is not None else '', np.array(heard), blade_pass_of(scenario.targets[0]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the confusion table."""
    parser = argparse.ArgumentParser(prog='drone_types', description=__doc__)
    parser.add_argument('--flights', type=int, default=10, help='of each type (%(default)s)')
    parser.add_argument('--seconds', type=float, default=8.0, help='of each flight (%(default)s)')
    parser.add_argument('--seed', type=int, default=1, help='of the first flight (%(default)s)')
    parser.add_argument('--workers', type=int, default=0, help='parallel processes; 0: one for each core')
    options = parser.parse_args(arguments)
    profiles = shipped('drones')
    jobs = [(profile, options.seed + flight) for profile in profiles for flight in range(options.flights)]
    with ProcessPoolExecutor(options.workers or os.cpu_count()) as pool:
        flights = list(pool.map(fly, *zip(*jobs, strict=True), repeat(options.seconds)))
    _print(profiles, flights)
    return 0


def _print(profiles: Sequence[str], flights: Sequence[Flight]) -> None:
    columns = [*profiles, NONE]
    print(f'{"is":<18}' + ''.join(f'{name:>18}' for name in columns) + f'{"fundamentals":>14}')
    for profile in profiles:
        own = [flight for flight in flights if flight.profile == profile]
        counts = Counter(flight.named or NONE for flight in own)
        known = [flight.right for flight in own if np.isfinite(flight.right)]
        right = f'{100 * np.mean(known):>12.0f} %' if known else f'{NONE:>14}'
        print(f'{profile:<18}' + ''.join(f'{counts[name]:>18}' for name in columns) + right, flush=True)
    named = sum(flight.named == flight.profile for flight in flights)
    wrong = sum(flight.named not in (flight.profile, '') for flight in flights)
    print(f'of {len(flights)} flights {100 * named / len(flights):.0f} % are named rightly, '
          f'{100 * wrong / len(flights):.0f} % wrongly')
