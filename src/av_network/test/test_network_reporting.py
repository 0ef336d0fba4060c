"""When a position is told: while it is precise, consistent, probable, and more than one rig observes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from av_network.calibration import RigCalibration
from av_network.hypothesis_filter import HypothesisFilter
from av_network.lone_track import LoneTrack
from av_network.network_target import Member, NetworkTarget
from av_network.observation import Observation, RigState, Sighting
from av_network.reporting import target_states
from av_network.settings import RigSettings

ALONE = LoneTrack(0.0, np.zeros(2), np.zeros((2, 2, 3)), np.zeros((2, 2, 3, 3)), np.ones(2) / 2)
KNOWN = NetworkTarget(0.0, 10.0, supported=10.0, id=1, odds=5.0)


def positioned(target, sigma=1.0, time=10.5):
    states = HypothesisFilter()
    states.predict(10.0)
    states.add(np.array([[0.0, 50.0, 20.0, 1.0, 0.0, 0.0]]), np.diag([sigma**2] * 3 + [1.0] * 3)[None])
    calibration = RigCalibration([RigSettings(str(rig), 0.0, 0.0) for rig in range(4)])
    (state,) = target_states(states, calibration, [target], dict.fromkeys(range(4), np.zeros(3)), time)
    assert np.allclose(state.mean[:3], [time - 10.0, 50.0, 20.0], atol=0.05)
    return state.positioned


@pytest.mark.parametrize('values', [{'nis': 3.1}, {'odds': -np.inf}, {'supported': 7.4}])
def test_a_position_that_is_not_verified_is_not_told(values):
    """Inconsistent, not the most probable, or observed by one rig alone for more than 3 s."""
    assert positioned(KNOWN) and not positioned(replace(KNOWN, **values))


def test_a_fourth_rig_makes_a_chance_meeting_improbable():
    """Innovations of 3.5 instead of 2 are believed of four rigs, those of 4.1 are not."""
    members = {rig: Member(1, 10.0, 5.0, ALONE) for rig in range(4)}
    inconsistent = replace(KNOWN, nis=3.5, members=members)
    assert positioned(inconsistent) and not positioned(replace(inconsistent, nis=4.1))
    del members[3]
    assert not positioned(replace(inconsistent, members=members))


def test_a_position_that_is_not_precise_is_not_told():
    """Root mean square error of 7 m and more, 10 % of the distance being less."""
    assert positioned(KNOWN, 3.5) and not positioned(KNOWN, 4.1)


def test_a_target_is_supported_while_two_rigs_observe_it():
    """One rig reports until 5 s, the other one until 2 s."""
    target = NetworkTarget(0.0, 0.0)
    for time in np.arange(0.0, 5.0, 0.25):
        for rig in (0, 1) if time <= 2.0 else (0,):
            one = Observation(rig, np.zeros(3), Sighting(rig, 0.0, 0.0, np.eye(2), time), RigState(0.0, 0.0, 0.0, 0.0, 0.0))
            target.note(one, float(time), 2.0, 0.0, ALONE)
    assert target.measured == 4.75 and target.supported == 3.5
