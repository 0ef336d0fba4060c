"""A rig that rolls and pitches by 25 deg at up to 60 deg/s, turns, passes below its target and flies: against geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tilted_rig import CAMERA, START, TiltedRig, level, rms, swaying, unit

from av_common.frames import FLU_TO_OPTICAL

SECONDS, SETTLED = 12.0, 4.0  # s


def passing(elevation_deg, rate_deg=2.0):
    """A target 20 m away that moves sideways, ahead of the rig."""
    return lambda t: 20.0 * unit(math.radians(5.0 + rate_deg * t), math.radians(elevation_deg))


def in_picture(attitude, target):
    """Whether the camera of a rig with an attitude has the target in its picture at a time (s)."""
    def seen(t):
        x, y, z = FLU_TO_OPTICAL @ attitude(t).inv().apply(target(t))
        return z > 0.0 and abs(CAMERA.fx * x / z) < 310.0 and abs(CAMERA.fy * y / z) < 230.0
    return seen


def heading_only(attitude):
    """What a rig that knows its yaw alone takes for its attitude."""
    def turned(t):
        matrix = attitude(t).as_matrix()
        return Rotation.from_euler('z', math.atan2(matrix[1, 0], matrix[0, 0]))
    return turned


def error(attitude, elevation_deg, sensors, reported=None):
    """RMSE (deg) across the line of sight in the body, with the images that the swaying rig gets."""
    target, errors = passing(elevation_deg), []
    seen = in_picture(swaying(), target)
    for seed in (1, 2, 3, 4):
        rig = TiltedRig(attitude, target, reported=reported, seed=seed, sound=lambda t: sensors != 'sight',
                        sight=seen if sensors != 'sound' else lambda t: t < 2.0 and seen(t))    # the side is known by then
        rig.run(SECONDS)
        times = [track.time - START for track in rig.tracks if track.time - START >= SETTLED]
        errors += (rig.azimuth_errors(SETTLED) * [math.hypot(*rig.body(t)[:2]) for t in times]).tolist()
    return rms(np.array(errors))


@pytest.mark.parametrize('elevation_deg', [5.0, 20.0])
@pytest.mark.parametrize(('sensors', 'most'), [('both', 1.2), ('sight', 1.2), ('sound', 1.3)])
def test_tilting_costs_little_and_knowing_the_yaw_alone_much(elevation_deg, sensors, most):
    """With the same images; by the yaw alone, as before, several times the error. 32 s a figure."""
    flat, tilted = (error(attitude, elevation_deg, sensors) for attitude in (level(), swaying()))
    before = error(swaying(), elevation_deg, sensors, heading_only(swaying()))
    print(f'{sensors}, {elevation_deg:.0f} deg up: level {flat:.2f}, tilting {tilted:.2f}, by yaw alone {before:.1f} deg')
    assert tilted < most * flat and not before < 4.0 * tilted    # NaN where nothing is followed


def test_tilting_tells_front_from_back_without_turning():
    """Sound alone, a swaying rig that turns nowhere: the axis of the pair tilts, and one image moves in the world."""
    rig = TiltedRig(swaying(20.0, 40.0), passing(25.0, 0.0), sight=lambda t: False)
    tracks = rig.run(10.0)
    assert any(track.resolved for track in tracks)
    resolved = [abs(e) for track, e in zip(tracks[-60:], rig.azimuth_errors(0.0)[-60:], strict=True) if track.resolved]
    assert resolved and max(resolved) < 30.0


@pytest.mark.parametrize('tilt', [level(), swaying(15.0, 40.0)])
def test_a_drone_that_passes_overhead_is_a_bearing_like_any_other(tilt):
    """With a camera that looks up: at 3 m/s, 10 m above, through the zenith at 4 s."""
    upwards = Rotation.from_euler('y', -90.0, degrees=True)
    rig = TiltedRig(tilt, lambda t: np.array([3.0 * (t - 4.0), 0.3, 10.0]), camera=upwards)
    rig.run(6.0)
    errors = rig.errors(3.0)    # it is seen from 2.9 s on at the latest
    assert len(errors) > 100 and errors.max() < 3.0
    for track in rig.tracks[-len(errors):]:
        assert np.isfinite([track.azimuth_world, track.elevation_world, *track.covariance_world]).all()


@pytest.mark.parametrize(('amplitude', 'omega', 'distance'), [(4.0, 1.5, 20.0), (8.0, 1.0, 20.0), (6.0, 1.0, 10.0)])
def test_motion_across_the_line_of_sight_tells_the_range_with_its_variance(amplitude, omega, distance):
    rig = TiltedRig(level(), lambda t: np.array([distance, 3.0, 2.0]), path=lambda t: np.array(
        [0.0, amplitude * math.sin(omega * t), 0.0]))
    late = [track for track in rig.run(12.0) if track.time - START > 5.0]
    assert np.mean([math.isfinite(track.range) for track in late]) > 0.7
    for track in late[::30]:
        truth = float(np.linalg.norm(rig.target(track.time - START) - rig.path(track.time - START)))
        if math.isfinite(track.range):
            assert abs(track.range - truth) < 2.0 * math.sqrt(track.range_variance) < 1.5 * truth


def test_a_rig_at_rest_knows_no_range():
    assert all(math.isnan(track.range) and math.isinf(track.range_variance)
               for track in TiltedRig(level(), lambda t: np.array([20.0, 3.0, 2.0])).run(6.0))


def test_without_attitude_the_rig_counts_as_level_and_says_so():
    rig = TiltedRig(level(), passing(5.0, 0.0), odometry=lambda t: False)
    assert not any(track.attitude_known for track in rig.run(3.0)) and rms(rig.azimuth_errors()) < 1.5
