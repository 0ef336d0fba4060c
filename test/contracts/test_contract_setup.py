"""A rig that is not as described says so, with what is wrong, and nothing moves by its bearings; one that is says nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from faulty_rig import Faults, FaultyRig, lies
from formula_rig import Source, unit
from scipy.spatial.transform import Rotation
from vehicle import Vehicle

from av_interfaces.msg import Bearing

TOLD_S = 25.0


def drone(seed):
    """One that flies back and forth ahead, heard and seen."""
    r = np.random.default_rng([3, seed])
    wide, fast, period, short, phase = r.uniform((9.0, 3.0, 7.0, 3.0, 0.0), (18.0, 6.0, 13.0, 5.0, 6.0))
    return Source(lambda t: unit(wide * math.sin(math.tau * t / period + phase) + fast * math.sin(math.tau * t / short), 8.0))


def turning(seed, largest=20.0):
    """A body that turns to and fro."""
    r = np.random.default_rng([4, seed])
    angle, period = r.uniform(0.6 * largest, largest), r.uniform(5.0, 8.0)
    return lambda t: Rotation.from_euler('z', angle * math.sin(math.tau * t / period), degrees=True)


def told(faults, seed, seconds=TOLD_S, **options):
    """The rig, and when (s) and what it first said for certain, or suspected where it never was certain."""
    rig = FaultyRig([drone(seed)], attitude=turning(seed), seed=seed, faults=faults, **options)
    first = None
    for t in rig.steps(seconds):
        fault = rig.stage.consistency.fault
        if fault is not None and (first is None or fault.is_certain > first[1].is_certain):
            first = (t, fault)
    return rig, first


@pytest.mark.parametrize(('faults', 'words'), [
    (Faults(swapped=True), 'microphones are exchanged'),
    (Faults(camera_yaw_deg=15.0), 'camera is turned by +1'), (Faults(camera_yaw_deg=-22.0), 'camera is turned by -2'),
    (Faults(mirrored=True), 'mirrored or upside down'), (Faults(upside_down=True), 'mirrored or upside down'),
    (Faults(yaw_sign=-1), 'yaw of the odometry has the wrong sign'), (Faults(delay=-0.45), 'one channel is late'),
    (Faults(spacing=1.6), 'as far apart as described')],
    ids=lambda value: '' if isinstance(value, str) else ','.join(f'{k}={v}' for k, v in vars(value).items() if v not in (0, 1)))
@pytest.mark.parametrize('seed', [0, 1])
def test_what_is_wrong_is_told(faults, words, seed):
    rig, first = told(faults, seed, TOLD_S if faults.spacing == 1.0 else 2.0 * TOLD_S)    # almost right by that one
    assert first is not None, rig.stage.consistency._bank.posterior().round(3)
    when, fault = first
    assert words in fault.text and fault.mend
    if fault.is_certain:
        after = rig.following(when + 0.2)
        assert after and all(moment.bearing.source == 0 and not moment.bearing.resolved for moment in after)
        assert all(moment.bearing.requested_rotation == 0.0 and 'not as described' in moment.state.reason for moment in after)
        assert lies(rig, when + 0.2) == 0.0


def test_sigma_grows_to_what_the_contradiction_supports():
    """With a camera that looks 22 deg aside the bearing is as uncertain as that."""
    rig, first = told(Faults(camera_yaw_deg=22.0), 2)
    assert first is not None and first[1].is_certain
    for moment in rig.following(first[0] + 0.2):
        assert math.degrees(math.sqrt(moment.bearing.azimuth_variance)) > 15.0


@pytest.mark.parametrize('seed', range(4))
def test_a_rig_as_described_says_nothing(seed):
    rig, first = told(Faults(camera_yaw_deg=1.0, late=0.02, spacing=1.02, focal=0.98), seed, 40.0)
    assert first is None and rig.followed(2.0) > 0.95


@pytest.mark.parametrize('place', [40.0, -60.0, 165.0])
def test_a_second_source_that_is_heard_is_no_fault(place):
    """A quiet drone is seen, another one is heard."""
    silent = drone(5)
    silent.heard = lambda t: False
    rig = FaultyRig([silent, Source.at(place, seen=lambda t: False)], attitude=turning(5), seed=5)
    rig.run(40.0)
    assert rig.stage.consistency.fault is None


def test_a_user_who_knows_better_decides():
    rig, first = told(Faults(camera_yaw_deg=22.0), 1, parameters={'setup_check': 'warn'})
    assert first is not None and first[1].is_certain
    assert any(moment.bearing.source & Bearing.SOURCE_SIGHT for moment in rig.following(first[0] + 1.0))


def test_nothing_moves_by_a_contradicted_bearing():
    """The camera looks 25 deg aside: once that is certain, the body stands, though the drone goes on."""
    vehicle = Vehicle([drone(1)], rig=FaultyRig, faults=Faults(camera_yaw_deg=25.0))
    while (fault := vehicle.rig.stage.consistency.fault) is None or not fault.is_certain:
        vehicle.run(0.5)
        assert vehicle.rig.now < 40.0
    told = vehicle.rig.now
    vehicle.run(6.0)
    assert any(abs(command.yaw_rate) > 0.05 for command in vehicle.between(0.0, told))
    assert not any(command.yaw_rate for command in vehicle.between(told + 0.5))


def test_a_mended_rig_is_believed_again():
    """The camera is turned back; its fault is told no more."""
    rig, first = told(Faults(swapped=True), 0, 12.0)
    assert first is not None
    rig.faults = Faults()
    rig.run(60.0)
    assert rig.stage.consistency.fault is None
