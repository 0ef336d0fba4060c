"""A rig that is not as described says so, with what is wrong, and nothing moves by its bearings; one that is says nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from faulty_rig import FaultyRig, drone, lies, turning, turning_rig
from formula_rig import START, Source, azimuth_of, never, wrapped
from judged_rig import FormulaRig
from scipy.spatial.transform import Rotation
from vehicle import Vehicle

from av_evaluation.faults import Faults, named, title
from av_interfaces.msg import Bearing, PointingCommand

TOLD_S = 25.0
SECOND = {'second_camera': lambda t: Rotation.identity()}


def told(faults, seed, seconds=TOLD_S, largest=20.0, **options):
    """The rig, and when (s) and what it first said for certain, or suspected where it never was certain."""
    rig = turning_rig(faults, seed, largest, **options)
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
    (Faults(rolled_deg=90.0), 'rolled to the right by 90'), (Faults(rolled_deg=-90.0), 'rolled to the left by 90'),
    (Faults(camera_yaw_deg=-90.0), 'camera is turned by -9'), (Faults(camera_yaw_deg=165.0), 'camera is turned by +16'),
    (Faults(yaw_sign=-1), 'yaw of the odometry has the wrong sign'), (Faults(delay=-0.45), 'one channel is late'),
    (Faults(spacing=1.6), 'as far apart as described')],
    ids=lambda value: '' if isinstance(value, str) else ','.join(f'{k}={v}' for k, v in vars(value).items() if v not in (0, 1)))
@pytest.mark.parametrize('seed', [0, 1])
def test_what_is_wrong_is_told(faults, words, seed):
    rig, first = told(faults, seed, TOLD_S if faults.spacing == 1.0 else 2.0 * TOLD_S)    # almost right by that one
    assert first is not None, rig.stage.consistency.belief
    when, fault = first
    assert words in fault.text and fault.mend
    # Long before it is named the description is doubted: by the second window of sound, or the first turn.
    assert max(lies(rig, 0.0, when), lies(rig, 0.0, when, in_world=True)) * when < 3.0
    if fault.is_certain:
        after = rig.following(when + 0.2)
        assert after and all(moment.bearing.source == 0 and not moment.bearing.resolved for moment in after)
        assert all(moment.bearing.requested_rotation == 0.0 and 'not as described' in moment.state.reason for moment in after)
        assert lies(rig, when + 0.2) == 0.0


@pytest.mark.parametrize('array', ['pair', 'square'])
@pytest.mark.parametrize('faulty', ['camera', 'second_camera'])
@pytest.mark.parametrize('fault', [Faults(camera_yaw_deg=-22.0), Faults(mirrored=True)], ids=title)
def test_of_two_cameras_the_one_that_is_mounted_otherwise_is_left_out(fault, faulty, array):
    """Each is compared with what is heard; once sound and the other one agree, bearings rest on these."""
    rig, told_at = turning_rig(fault, 0, faulty=faulty, others=SECOND, array=array), None
    for t in rig.steps(TOLD_S):
        told_at = told_at or (t if rig.stage.left_out else None)
    told, other = rig.stage.consistency.fault, ({'camera', 'second_camera'} - {faulty}).pop()
    assert told_at is not None and rig.stage.left_out == {faulty}
    assert f'the {faulty.replace("_", " ")} is' in told.text and f'the {other.replace("_", " ")} is' not in told.text
    assert faulty in told.mend
    after = rig.following(told_at + 1.0)
    assert len(after) > 0.95 * len(rig.between(told_at + 1.0)) and lies(rig, told_at + 0.2) == 0.0
    errors = [abs(wrapped(math.degrees(one.bearing.azimuth) - azimuth_of(rig.body(one.t)))) for one in after]
    assert np.mean(np.array(errors) < 3.0) > 0.95
    assert all(one.bearing.source & Bearing.SOURCE_SIGHT and one.bearing.resolved for one in after[-20:])
    assert all(f'{faulty} not used: ' in one.state.reason for one in after[-20:])


def test_no_camera_is_left_out_where_a_user_decides():
    rig, first = told(Faults(mirrored=True), 0, faulty='second_camera', others=SECOND, parameters={'setup_check': 'warn'})
    assert first is not None and not rig.stage.left_out
    assert not any('not used' in moment.state.reason for moment in rig.moments)


def test_exchanged_microphones_stop_a_rig_of_two_cameras():
    """Neither camera confirms what is heard."""
    rig, first = told(Faults(swapped=True), 0, others=SECOND)
    assert first is not None and first[1].is_certain and not rig.stage.left_out
    assert all(moment.bearing.source == 0 for moment in rig.following(first[0] + 0.2))


@pytest.mark.parametrize('seed', [0, 1])
def test_late_images_are_told_with_their_value(seed):
    """By a rig that turns by up to 20 deg/s and more, at which they lie."""
    rig, first = told(Faults(late=0.3), seed, largest=35.0)
    assert first is not None and 0.2 < float(first[1].text.split()[3]) < 0.4
    assert lies(rig, first[0] + 0.2) == 0.0


def test_a_turned_camera_is_told_by_a_rig_that_turns_far():
    """By up to 60 deg, with which the drone leaves the picture for half of the time."""
    _, first = told(Faults(camera_yaw_deg=-16.0), 3, largest=60.0)
    assert first is not None and 'camera is turned by -1' in first[1].text


@pytest.mark.parametrize('array', ['square', 'eight'])
@pytest.mark.parametrize('faults', [
    Faults(camera_yaw_deg=-17.0), Faults(mirrored=True), Faults(yaw_sign=-1), Faults(rolled_deg=90.0), Faults(rolled_deg=-90.0),
    Faults(camera_yaw_deg=95.0), Faults(camera_yaw_deg=170.0)], ids=title)
def test_arrays_that_tell_front_from_back_tell_faults_too(faults, array):
    rig, first = told(faults, 3, 20.0, array=array)
    assert first is not None and named(faults, first[1])
    assert lies(rig, first[0] + 0.2) == lies(rig, first[0] + 0.2, in_world=True) == 0.0


@pytest.mark.parametrize('faults', [
    Faults(swapped=True, yaw_sign=-1), Faults(mirrored=True, camera_yaw_deg=18.0), Faults(yaw_sign=-1, camera_yaw_deg=-20.0)],
    ids=title)
def test_of_two_faults_none_is_named_that_is_not_there(faults):
    """Microphones exchanged and the wrong sign of yaw are, to every sensor, a mirrored image: then both are named."""
    _, first = told(faults, 2)
    assert first is not None and named(faults, first[1]), first


def test_a_fault_is_known_after_the_clock_was_set_back():
    rig, first = told(Faults(swapped=True), 0, 12.0)
    assert first is not None
    monitor = rig.stage.consistency
    assert monitor.advance(START + rig.now - 60.0) is first[1] or monitor.fault is not None
    assert 'exchanged' in monitor.fault.text


def test_sigma_grows_to_what_the_contradiction_supports():
    """With a camera that looks 22 deg aside the bearing is as uncertain as that."""
    rig, first = told(Faults(camera_yaw_deg=22.0), 2)
    assert first is not None and first[1].is_certain
    sigmas = [math.degrees(math.sqrt(moment.bearing.azimuth_variance)) for moment in rig.following(first[0] + 0.2)]
    assert sigmas and min(sigmas) > 15.0


def test_what_both_sensors_confirm_is_not_doubted():
    """A set-up that nothing confirmed is uncertain by degrees; once sound and sight agree, by less than the filter itself."""
    rigs = [turning_rig(Faults(), 4, parameters={'setup_check': check}).run(6.0) for check in ('stop', 'warn')]
    sigmas = [[math.degrees(math.sqrt(moment.bearing.azimuth_variance)) for moment in rig.following(*when)]
              for rig in rigs for when in ((0.6, 0.9), (3.0, 6.0))]
    assert max(sigmas[0]) > 2.5 and sum(sigmas[1]) < 1.1 * sum(sigmas[3])


@pytest.mark.parametrize('seed', range(4))
def test_a_rig_as_described_says_nothing(seed):
    rig, first = told(Faults(camera_yaw_deg=1.0, late=0.02, spacing=1.02, focal=0.98), seed, 40.0)
    assert first is None and rig.followed(2.0) > 0.95


def test_two_cameras_as_described_say_nothing():
    rig, first = told(Faults(), 2, 40.0, others=SECOND)
    assert first is None and rig.followed(2.0) > 0.95


@pytest.mark.parametrize('place', [40.0, -60.0, 165.0])
def test_a_second_source_that_is_heard_is_no_fault(place):
    """A quiet drone is seen, another one is heard."""
    silent = drone(5)
    silent.heard = lambda t: False
    rig = FaultyRig([silent, Source.at(place, seen=lambda t: False)], attitude=turning(5), seed=5)
    rig.run(40.0)
    assert rig.stage.consistency.fault is None


@pytest.mark.parametrize('faults', [Faults(camera_yaw_deg=22.0), Faults(swapped=True), Faults()], ids=title)
def test_while_several_things_are_seen_faults_are_told_too(faults):
    """Beside the drone hovers another one that is silent."""
    rig, first = FaultyRig([drone(1), Source.at(-15.0, 8.0, heard=never)], attitude=turning(1), seed=1, faults=faults), None
    for _ in rig.steps(TOLD_S):
        first = first or rig.stage.consistency.fault
    assert first is None if faults == Faults() else named(faults, first)


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


@pytest.mark.parametrize('array', ['pair', 'eight'])
@pytest.mark.parametrize('faults', [Faults(frozen=True), Faults(stuck=True), Faults()], ids=title)
def test_a_heading_that_does_not_follow_the_commands_is_told(faults, array):
    """The body turns as it is commanded, after a drone that flies around; odometry shows none of it."""
    vehicle, told = Vehicle([Source.at(35.0, 8.0, 11.0)], rig=FaultyRig, array=array, faults=faults), math.inf
    while vehicle.rig.now < 20.0:
        vehicle.run(0.1)
        fault = vehicle.rig.stage.consistency.fault
        assert fault is None or named(faults, fault), fault
        told = min(told, vehicle.rig.now) if fault else told
    assert vehicle.rig.followed(2.0) > 0.95 and math.degrees(vehicle.yaw[-1]) > 180.0
    assert told == math.inf if faults == Faults() else told < 10.0
    assert lies(vehicle.rig, min(told, 1.0) + 0.2) < 0.02 and lies(vehicle.rig, min(told, 20.0) + 0.2, in_world=True) < 0.02


@pytest.mark.parametrize('noise', [0.0, 1e-6])
def test_a_rig_that_stands_is_no_fault_unless_it_is_told_to_turn(noise):
    """Where measured headings differ from message to message, the vehicle is held by somebody: nothing is wrong."""
    rig = FormulaRig([drone(3)], attitude=lambda t: Rotation.from_euler('z', noise * math.sin(1e4 * t)))
    for t in rig.steps(20.0):
        if t > 10.0:
            rig.stage.on_command(PointingCommand(move_body=True, yaw_rate=0.3), START + t)
        assert t > 10.0 or rig.stage.consistency.fault is None
    fault = rig.stage.consistency.fault
    assert fault is None if noise else 'vehicle is held' in fault.text and not fault.is_certain


def test_a_mended_rig_is_believed_again():
    """The camera is turned back; its fault is told no more."""
    rig, first = told(Faults(swapped=True), 0, 12.0)
    assert first is not None
    rig.faults = Faults()
    rig.run(60.0)
    assert rig.stage.consistency.fault is None
