"""Figures of all tracks of a run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.angles import angles_to_direction
from av_common.rig import load_rig
from av_evaluation.experiments.offline_run import OfflineRun
from av_evaluation.metrics.tracks import CUTOFF_DEG, TrackComparison
from av_fusion.tracker import MultiTargetTracker
from av_simulator import Scenario, Static, Target, find_config, load_scenario


def at(azimuth_deg):
    return angles_to_direction(math.radians(azimuth_deg))


def test_errors_missed_and_false_targets_are_told_apart():
    """One target is followed with an error of 3 degrees, one is missed, and a track is false, in every second instant."""
    comparison = TrackComparison()
    truth = np.array([at(0.0), at(90.0)])
    for k in range(10):
        comparison.add(truth, {1: at(3.0)} | ({2: at(-90.0)} if k % 2 else {}))
    figures = comparison.figures()
    assert figures.localisation_deg == pytest.approx(3.0)
    assert (figures.missed, figures.false) == pytest.approx((1.0, 0.5))
    assert (figures.switches, figures.kept) == (0, 1.0)
    unit = 0.5 * CUTOFF_DEG**2
    assert figures.gospa_deg == pytest.approx(0.5 * (math.sqrt(9.0 + unit) + math.sqrt(9.0 + 2.0 * unit)))


def test_without_an_instant_nothing_is_known():
    assert math.isnan(TrackComparison().figures().gospa_deg)


def test_a_scenario_of_several_targets_is_compared_with_all_of_them():
    """Before the first bearing both are missed, later one at most."""
    scenario = load_scenario(find_config('two_drones', 'scenarios'))
    figures = OfflineRun(scenario, load_rig(find_config('rig')), MultiTargetTracker()).run(3.0).tracks
    assert figures is not None
    assert 0.0 < figures.missed < 2.0
    assert 0.0 < figures.gospa_deg < math.sqrt(2.0) * CUTOFF_DEG
    one = load_scenario(find_config('circle', 'scenarios'))
    assert OfflineRun(one, load_rig(find_config('rig')), MultiTargetTracker()).run(0.2).tracks is None


def test_a_target_at_the_rigs_own_place_has_no_direction_and_is_missed():
    scenario = Scenario('two', tuple(Target(Static((x, 0.0, 1.5))) for x in (0.0, 9.0)))
    figures = OfflineRun(scenario, load_rig(find_config('rig')), MultiTargetTracker()).run(1.5).tracks
    assert figures is not None and 1.0 <= figures.missed < 2.0
