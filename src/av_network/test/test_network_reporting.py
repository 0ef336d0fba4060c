"""When a position is told: while it is precise, consistent, probable, and more than one rig observes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from av_network.calibration import RigCalibration
from av_network.hypothesis_filter import HypothesisFilter
from av_network.lone_track import LoneTrack
from av_network.network_target import Member, NetworkTarget
from av_network.observation import RigSettings, Sighting
from av_network.reporting import target_states

ALONE = LoneTrack(0.0, np.zeros(2), np.zeros((2, 2, 3)), np.zeros((2, 2, 3, 3)), np.ones(2) / 2)
SEEN = Sighting(1, 0.0, 0.0, np.eye(2), 10.0)

PLACES = {rig: np.array([20.0 * rig - 30.0, 0.0, 0.0]) for rig in range(4)}


def members(*times):
    return {rig: Member(SEEN, time, 5.0, ALONE) for rig, time in enumerate(times)}


KNOWN = NetworkTarget(0.0, 10.0, id=1, odds=5.0, members=members(10.0, 10.0))


def positioned(target, sigma=1.0, time=10.5):
    states = HypothesisFilter()
    states.predict(10.0)
    states.add(np.array([[0.0, 50.0, 20.0, 1.0, 0.0, 0.0]]), np.diag([sigma**2] * 3 + [1.0] * 3)[None])
    calibration = RigCalibration([RigSettings(str(rig), 0.0, 0.0) for rig in range(4)])
    (state,) = target_states(states, calibration, [target], PLACES, time)
    assert np.allclose(state.mean[:3], [time - 10.0, 50.0, 20.0], atol=0.05)
    return state.positioned


@pytest.mark.parametrize('values', [{'nis': 3.1}, {'odds': -np.inf}, {'members': members(10.0, 6.4)}])
def test_a_position_that_is_not_verified_is_not_told(values):
    """Inconsistent, not the most probable, or observed by one rig alone for more than 4 s."""
    assert positioned(KNOWN) and not positioned(replace(KNOWN, **values))


def test_a_fourth_rig_makes_a_chance_meeting_improbable():
    """Innovations of 3.5 instead of 2 are believed of four rigs, those of 4.1 are not."""
    inconsistent = replace(KNOWN, nis=3.5, members=members(*[10.0] * 4))
    assert positioned(inconsistent) and not positioned(replace(inconsistent, nis=4.1))
    assert not positioned(replace(inconsistent, members=members(*[10.0] * 3)))


def test_a_position_that_is_not_precise_is_not_told():
    """Root mean square error of 7 m and more, 10 % of the distance being less."""
    assert positioned(KNOWN, 3.5) and not positioned(KNOWN, 4.1)


def test_what_a_target_is_by_what_its_rigs_have_told_last():
    """The mean of the log-odds, and the name that most of them give it; nothing while none tells."""
    told = [(0.9, 'drone'), (0.5, 'bird'), (np.nan, 'drone'), (np.nan, '')]
    target = replace(KNOWN, told={0: 0.9, 1: 0.5}, members={
        rig: Member(SEEN._replace(drone_probability=p, class_id=name), 10.0, 5.0, ALONE) for rig, (p, name) in enumerate(told)})
    assert target.drone_probability == pytest.approx(0.75) and target.class_id == 'drone'
    assert np.isnan(KNOWN.drone_probability) and KNOWN.class_id == ''
