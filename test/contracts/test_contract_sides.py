"""Front or back of a pair, by formulas: open while nothing tells it, told by turns, tilts, detections and their absence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from figures import at_least, at_most, within
from formula_rig import Source, azimuth_of, never, wrapped
from judged_rig import FormulaRig
from scipy.spatial.transform import Rotation

from av_common.rig import GimbalMount
from av_interfaces.msg import Bearing


def yawing(begin, rate_deg, turn_deg):
    """A rig that stands, then turns by an angle from `begin` (s) on."""
    return lambda t: Rotation.from_euler('z', math.copysign(min(max(t - begin, 0.0) * abs(rate_deg), abs(turn_deg)), turn_deg),
                                         degrees=True)


def declared(rig, after=0.0):
    """Whether each resolved bearing after a time (s) is on the wrong side."""
    wrong = []
    for moment in rig.following(after):
        if moment.bearing.resolved:
            truth, azimuth = azimuth_of(rig.body(moment.t)), math.degrees(moment.bearing.azimuth)
            wrong.append(abs(wrapped(azimuth - truth)) > abs(wrapped(180.0 - azimuth - truth)))
    return wrong


@pytest.mark.parametrize('azimuth', [140.0, -115.0, 20.0])
def test_sound_alone_on_a_rig_at_rest_leaves_both_sides_equal(contract, azimuth):
    """The mirror images are the same measurement: nothing that is heard may prefer one."""
    rigs = [FormulaRig([Source.at(azimuth)], sight=never, seed=seed).run(6.0) for seed in range(2)]
    moments = [moment for rig in rigs for moment in rig.following(1.0)]
    contract(within('probability of the front, least', min(m.state.front_probability for m in moments), 0.4, 0.6),
             within('probability of the front, most', max(m.state.front_probability for m in moments), 0.4, 0.6),
             at_least('followed', min(rig.followed(2.0) for rig in rigs), 1.0))
    assert not any(moment.bearing.resolved for moment in moments)
    assert all(track.hemisphere_probability < 0.6 for moment in moments for track in moment.targets.tracks)
    assert any(moment.bearing.requested_rotation != 0.0 for moment in moments)


@pytest.mark.parametrize(('azimuth', 'rate'), [(140.0, 4.0), (-150.0, -6.0), (25.0, 0.0), (170.0, 6.0)])
def test_a_turn_tells_the_side(contract, azimuth, rate):
    """40 deg within a second move the mirror images apart by 80 deg, 50 times the error of a window."""
    wrong, ends, sooner = [], [], []
    for seed in range(8):
        rig = FormulaRig([Source.at(azimuth, 4.0, rate)], sight=never, seed=seed,
                         attitude=yawing(2.0, 40.0, 40.0 if seed % 2 else -40.0)).run(4.5)
        wrong += declared(rig)
        sooner += declared(rig, 0.0)[:1] if any(m.bearing.resolved for m in rig.between(0.0, 2.0)) else []
        last = rig.moments[-1].bearing
        ends.append(last.resolved and not declared(rig, 4.3)[-1])
    contract(at_most('declared wrong', float(np.mean(wrong or [1.0])), 0.05),
             at_least('decided right', float(np.mean(ends)), 0.95), at_most('decided before the turn', len(sooner), 0))


def test_the_rotation_that_is_asked_for_tells_the_side(contract):
    """A rig that obeys at 40 deg/s: within 3 s, wherever the target stands behind it."""
    times, wrong = [], []
    for seed in range(10):
        azimuth, yaw = np.random.default_rng([5, seed]).uniform(100.0, 260.0), [0.0]
        rig = FormulaRig([Source.at(azimuth, 5.0)], sight=never, seed=seed,
                         attitude=lambda t, yaw=yaw: Rotation.from_euler('z', np.interp(t, 0.02 * np.arange(len(yaw)), yaw)))
        for _ in rig.steps(6.0):
            bearing = rig.moments[-1].bearing if rig.moments else Bearing()
            if bearing.state != Bearing.STATE_NONE and bearing.resolved:
                break
            most = math.radians(40.0) * 0.02
            yaw.append(yaw[-1] + min(max(bearing.requested_rotation, -most), most))
        away = abs(abs(wrapped(azimuth - math.degrees(yaw[-1]))) - 90.0)
        times.append(rig.now)
        wrong += declared(rig)[-1:] if away > 5.0 else []   # at end-fire both sides are one
    contract(at_most('time, median', float(np.median(times)), 2.0, 's'), at_most('time, longest', max(times), 4.0, 's'),
             at_most('declared wrong', float(np.mean(wrong)), 0.1))


def test_tilting_tells_the_side_of_what_is_above(contract):
    """Roll and pitch of 20 deg tip the axis of the pair; of a target 25 deg up one image then moves in the world."""
    def attitude(t):
        return Rotation.from_euler('ZYX', [0.0, 20.0 * math.sin(1.6 * t), 20.0 * math.sin(2.0 * t + 1.0)], degrees=True)
    wrong, ends = [], []
    for seed in range(5):
        rig = FormulaRig([Source.at(30.0 if seed % 2 else 150.0, 25.0)], sight=never, attitude=attitude, seed=seed).run(10.0)
        wrong += declared(rig)
        ends.append(bool(rig.moments[-1].bearing.resolved))
    contract(at_most('declared wrong', float(np.mean(wrong or [1.0])), 0.05), at_least('decided', float(np.mean(ends)), 0.8))


def test_a_pair_that_turns_is_not_misled_by_what_flies_above_the_view_of_its_camera(contract):
    """40 deg up, 12 deg above the images, which show nothing: the cosine falls with the elevation, its sign tells the side."""
    wrong, far = [], []
    for seed, azimuth in enumerate((20.0, 50.0, 110.0, -40.0, -150.0)):
        rig = FormulaRig([Source.at(azimuth, 40.0)], visibility=lambda t: 1.0, seed=seed,
                         attitude=lambda t: Rotation.from_euler('z', 25.0 * math.sin(0.8 * t), degrees=True)).run(14.0)
        wrong += declared(rig, 4.0)
        far += [abs(wrapped(math.degrees(m.bearing.azimuth) - azimuth_of(rig.body(m.t)))) > 20.0 for m in rig.following(4.0)
                if m.bearing.resolved]
    contract(at_most('declared wrong', float(np.mean(wrong)), 0.05),
             at_most('resolved beyond 20 deg', float(np.mean(far)), 0.2))


def test_what_comes_to_the_plane_of_three_microphones_and_turns_back_keeps_its_side(contract):
    """An upright triangle mirrors left and right; the rig swings by 40 deg, and the target is in its plane at one end."""
    rigs = [FormulaRig([Source.at(140.0, 20.0)], array='upright', sight=never, seed=seed,
                       attitude=lambda t: Rotation.from_euler('z', 40.0 * math.sin(t), degrees=True)).run(10.0)
            for seed in range(4)]
    off = [abs(wrapped(math.degrees(m.bearing.azimuth) - azimuth_of(rig.body(m.t)))) > 30.0 for rig in rigs
           for m in rig.following(3.0) if m.bearing.resolved]
    contract(at_most('resolved beyond 30 deg', float(np.mean(off)), 0.05),
             at_least('resolved', len(off) / sum(len(rig.following(3.0)) for rig in rigs), 0.5))


def test_a_detection_tells_the_side(contract):
    """Heard for 2 s without images, then the camera shows it: in front, within three images."""
    times = []
    for seed in range(4):
        rig = FormulaRig([Source.at(22.0, 4.0)], sight=lambda t: t > 2.0, detection_probability=1.0, seed=seed).run(4.0)
        assert not any(moment.bearing.resolved for moment in rig.between(0.0, 2.0)) and not any(declared(rig))
        times.append(next((m.t for m in rig.following(2.0) if m.bearing.resolved), math.inf) - 2.0)
    contract(at_most('time from the first image, longest', max(times), 0.5, 's'))


@pytest.mark.parametrize('azimuth', [160.0, -170.0, 153.0])
def test_clear_images_without_it_tell_that_it_is_behind(contract, azimuth):
    """One of two equal images lies in view of a camera that finds nine of ten: after five such images 1 of 10000 is left."""
    rigs = [FormulaRig([Source.at(azimuth)], visibility=lambda t: 1.0, seed=seed).run(6.0) for seed in range(3)]
    times = [next((m.t for m in rig.following() if m.bearing.resolved), math.inf) for rig in rigs]
    contract(at_most('time, longest', max(times), 2.5, 's'), at_most('error, RMS', rms_of(rigs), 3.0, 'deg'),
             at_most('declared wrong', float(sum(map(sum, map(declared, rigs)))), 0))


def test_images_of_a_detector_that_misses_one_drone_in_ten_do_not_tell_the_side(contract):
    """It states 0.9 in clear air; a drone that it misses, it misses in each image: odds of 10 to 1 at most."""
    rig = FormulaRig([Source.at(160.0)], visibility=lambda t: 0.9, seed=1).run(10.0)
    contract(at_least('probability of the back at last', 1.0 - rig.moments[-1].state.front_probability, 0.8))
    assert not any(moment.bearing.resolved for moment in rig.moments)


@pytest.mark.parametrize(('name', 'visibility'), [('dense fog', lambda t: 0.0), ('unknown', None)])
def test_images_that_show_nothing_in_fog_tell_nothing(contract, name, visibility):
    rig = FormulaRig([Source.at(160.0)], visibility=visibility, seed=1).run(6.0)
    contract(within(f'{name}: probability of the front', rig.moments[-1].state.front_probability, 0.4, 0.6))
    assert not any(moment.bearing.resolved for moment in rig.moments)


def test_an_image_of_smoke_tells_no_more_than_its_visibility(contract):
    """Clear air beside the rig, smoke where the camera then looks: one drone in ten would be seen there, odds of 9 to 10."""
    def camera(t):
        return Rotation.from_euler('z', 90.0 - min(max(t - 3.0, 0.0) * 120.0, 90.0), degrees=True)
    rigs = [FormulaRig([Source.at(20.0, 4.0, seen=never)], camera=camera, gimbal=GimbalMount(), seed=seed,
                       visibility=lambda t: 1.0 if t < 3.0 else 0.1).run(7.0) for seed in range(3)]
    contract(at_least('probability of the front, least',
                      min(m.state.front_probability for rig in rigs for m in rig.between(3.0)), 0.4))
    assert not any(moment.bearing.resolved for rig in rigs for moment in rig.moments)


def test_a_side_out_of_view_is_not_excluded(contract):
    """A target at 70 deg is out of view on either side: images without it tell nothing."""
    rig = FormulaRig([Source.at(70.0)], visibility=lambda t: 1.0).run(6.0)
    contract(within('probability of the front', rig.moments[-1].state.front_probability, 0.35, 0.65))


def test_a_gimbal_camera_that_looks_back_tells_the_side(contract):
    """It pans to 150 deg at 120 deg/s and sees the target there; the orientation of each capture counts."""
    def camera(t):
        return Rotation.from_euler('z', min(max(t - 2.0, 0.0) * 120.0, 150.0), degrees=True)
    rigs = [FormulaRig([Source.at(160.0, 4.0)], camera=camera, gimbal=GimbalMount(), seed=seed).run(6.0) for seed in range(3)]
    times = [next((m.t for m in rig.following(2.0) if m.bearing.resolved), math.inf) - 2.0 for rig in rigs]
    contract(at_most('time from the begin of the pan, longest', max(times), 2.0, 's'),
             at_most('error after it, RMS', rms_of(rigs, 4.5), 0.5, 'deg'),
             at_most('declared wrong', float(sum(map(sum, map(declared, rigs)))), 0))


def test_a_gimbal_that_pans_across_the_target_sees_it_where_it_is(contract):
    """+-30 deg at up to 94 deg/s: an orientation that is 0.1 s late would be wrong by 9 deg."""
    def camera(t):
        return Rotation.from_euler('z', 30.0 * math.sin(math.pi * t), degrees=True)
    rig = FormulaRig([Source.at(5.0, 3.0)], camera=camera, gimbal=GimbalMount(), sound=never).run(8.0)
    contract(at_most('error, RMS', rms_of([rig]), 0.4, 'deg'))


def rms_of(rigs, after=3.0):
    return float(np.sqrt(np.mean(np.concatenate([rig.errors(after) for rig in rigs]) ** 2)))
