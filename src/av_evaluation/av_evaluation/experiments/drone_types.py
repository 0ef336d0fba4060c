"""Types of drones by their sound: rendered flights of each acoustic profile, heard by the rig and named by its tracker."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_evaluation.experiments.measurement_simulation import blade_pass_of
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.settings import types_of
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_simulator.config_files import find_config
from av_simulator.profile import Profile
from av_simulator.scenario import Scenario, Target, Weather
from av_simulator.sound.noise import Noise, Snr
from av_simulator.trajectories import RandomFlight

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
