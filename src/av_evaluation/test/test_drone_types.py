"""Rendered drones are named by their sound."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_evaluation.experiments.measurement_simulation import blade_pass_of
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.settings import types_of
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_simulator import RandomFlight, Scenario, Target, Weather, find_config
from av_simulator.sound.noise import Noise, Snr

FOG = 0.8    # 1/m, so that nothing is seen


@pytest.mark.parametrize('profile', ['hexarotor', 'mini_quadrotor'])
def test_a_track_has_the_type_of_the_drone_that_was_rendered(profile):
    """In fog, at a random place, with noise: the fundamental is that of the profile's rotors."""
    random = np.random.default_rng(21)
    azimuth, distance = random.uniform(-math.pi, math.pi), random.uniform(6.0, 20.0)
    centre = (distance * math.cos(azimuth), distance * math.sin(azimuth), 5.0)
    scenario = Scenario(
        'drone_types', (Target(RandomFlight(centre, (3.0, 3.0, 1.0), 8.0, 21), profile, drone=profile),), 5.0, 21,
        weather=Weather(fog=FOG), noise=Noise(snr=Snr(float(random.uniform(0.0, 20.0)))))
    tracker = MultiTargetTracker(TrackerSettings(types=types_of(node_parameters('av_fusion', 'fusion_node').types)))
    run = OfflineRun(scenario, load_rig(find_config('rig')), tracker)
    run.run()
    targets = tracker.targets(tracker.estimate(run.world.time)).targets
    assert max(targets, key=lambda target: target.existence).kind == profile
    heard = np.array([doa.fundamental for event in run.log.events if isinstance(event, list) for doa in event])
    known = heard[np.isfinite(heard)]
    assert np.mean(np.abs(np.log(known / blade_pass_of(scenario.targets[0]))) < 0.15) > 0.5
