"""The rig's attitude and path at any instant, against scipy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_common.angles import wrap
from av_fusion.measurement.rig_motion import KEPT_S, Pose, RigMotion


def pose(time, rotation, rate=(0.0, 0.0, 0.0), **values):
    x, y, z, w = rotation.as_quat()
    return Pose(time, (w, x, y, z), tuple(map(float, rate)), **values)


def swaying(time):
    """A rig that pitches and rolls by 25 degrees and turns; its rotation and its body rates by differences."""
    at = lambda t: Rotation.from_euler('ZYX', [40.0 * t + 170.0, 25.0 * math.sin(2.0 * t),  # noqa: E731
                                               25.0 * math.cos(1.7 * t)], degrees=True)
    return at(time), (at(time - 1e-5).inv() * at(time + 1e-5)).as_rotvec() / 2e-5


def test_interpolates_the_full_attitude_and_extrapolates_it_by_its_rates():
    """Within 0.2 degrees between poses at 20 Hz, 0.5 degrees 0.1 s after the newest."""
    motion = RigMotion()
    for k in range(60):
        motion.add(pose(0.05 * k, *swaying(0.05 * k)))
    for time in np.arange(0.01, 2.94, 0.037):
        error = Rotation.from_matrix(motion.attitude(float(time))).inv() * swaying(time)[0]
        assert math.degrees(error.magnitude()) < 0.2
    error = Rotation.from_matrix(motion.attitude(3.05)).inv() * swaying(3.05)[0]
    assert math.degrees(error.magnitude()) < 0.7
    np.testing.assert_allclose(motion.rate(2.95), swaying(2.95)[0].apply(swaying(2.95)[1]), atol=1e-6)
    assert motion.jumps == 0 and motion.problem(2.95) == ''


def test_interpolates_across_the_seam_and_extrapolates_by_rate():
    """A steady turn through +-180 degrees is linear in time."""
    motion, rate = RigMotion(), 1.0
    for k in range(100):
        motion.add(Pose.level(0.1 * k, float(wrap(3.0 + rate * 0.1 * k)), rate))
    for time in (0.05, 0.14, 0.17, 5.55, 9.9, 10.1):
        assert abs(wrap(motion.yaw(time) - (3.0 + rate * time))) < 1e-9
    assert motion.rate(5.0) == pytest.approx((0.0, 0.0, rate))


def test_without_poses_the_rig_counts_as_level_and_at_rest():
    motion = RigMotion()
    assert motion.yaw(123.0) == 0.0 and motion.rate(5.0) == (0.0, 0.0, 0.0) and motion.moved(1.0, 5.0) == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(motion.attitude(7.0), np.eye(3))
    assert not motion.is_known(7.0) and motion.problem(7.0) == ''


def test_late_poses_are_ignored_and_a_restart_is_accepted():
    """Repeated and reordered poses change nothing; a clock that restarts empties the history."""
    motion = RigMotion()
    motion.add(Pose.level(100.0, 0.5))
    for time in (100.0, 99.0):
        motion.add(Pose.level(time, 2.0))
    assert motion.yaw(100.0) == pytest.approx(0.5)
    motion.add(Pose.level(3.0, 1.5))
    assert motion.newest == 3.0 and motion.yaw(3.0) == pytest.approx(1.5)


def test_memory_is_bounded():
    """Hours of poses leave seconds in the history."""
    motion = RigMotion()
    for k in range(20000):
        motion.add(Pose.level(0.01 * k, 0.0))
    assert len(motion._poses.entries) <= 2 * KEPT_S / 0.01 + 2


@pytest.mark.parametrize('twist', [True, False])
def test_the_path_follows_the_velocity_in_the_body_or_the_positions(twist):
    """A rig that flies a circle of 5 m at 4 m/s, with its twist in the body frame or without one."""
    motion = RigMotion()
    at = lambda t: np.array([5.0 * math.cos(0.8 * t), 5.0 * math.sin(0.8 * t), 2.0])  # noqa: E731
    for k in range(100):
        t = 0.05 * k
        attitude = Rotation.from_euler('ZYX', [math.degrees(0.8 * t) + 90.0, 10.0, 5.0], degrees=True)
        world = (at(t + 1e-6) - at(t - 1e-6)) / 2e-6
        body = tuple(map(float, attitude.inv().apply(world))) if twist else (0.0, 0.0, 0.0)
        motion.add(pose(t, attitude, attitude.inv().apply([0.0, 0.0, 0.8]), velocity=body, position=tuple(map(float, at(t)))))
    np.testing.assert_allclose(motion.moved(1.02, 3.4), at(3.4) - at(1.02), atol=0.05)
    np.testing.assert_allclose(motion.velocity(4.95), (at(4.95) - at(4.94)) / 0.01, atol=0.25)
    assert motion.jumps == 0


def test_a_jump_of_the_position_moves_nothing_and_is_noticed():
    motion = RigMotion()
    for k in range(40):
        motion.add(Pose(0.05 * k, velocity=(1.0, 0.0, 0.0), position=(0.05 * k + 40.0 * (k >= 20), 0.0, 0.0)))
    np.testing.assert_allclose(motion.moved(0.5, 1.5), (1.0, 0.0, 0.0), atol=1e-6)
    assert motion.jumps == 1 and 'jumped in position' in motion.problem(2.0) and motion.problem(9.0) != motion.problem(2.0)


def test_a_jump_of_the_attitude_turns_the_history():
    """An estimator corrects its heading by 50 degrees: what was before is turned with it, to the tilt."""
    motion, correction = RigMotion(), Rotation.from_euler('z', 50.0, degrees=True)
    found = []
    for k in range(60):
        attitude, rate = swaying(0.05 * k)
        jump = motion.add(pose(0.05 * k, correction * attitude if k >= 40 else attitude, rate))
        if jump is not None:
            found.append(Rotation.from_matrix(jump))
    first, *found = found    # from level and facing east to the first pose
    assert len(found) == motion.jumps == 1 and first.approx_equal(swaying(0.0)[0], 1e-9)
    assert math.degrees((found[0].inv() * correction).magnitude()) < 1.0
    error = Rotation.from_matrix(motion.attitude(1.0)).inv() * correction * swaying(1.0)[0]
    assert math.degrees(error.magnitude()) < 1.0 and 'attitude' in motion.problem(3.0)


def test_odometry_that_stops_or_freezes_is_noticed():
    """After a second without poses the attitude is not known, and the tilt returns to level; so it is while it is frozen."""
    tilted = Rotation.from_euler('ZYX', [30.0, 20.0, -15.0], degrees=True)
    motion = RigMotion()
    for k in range(40):
        motion.add(pose(0.05 * k, tilted))
    assert motion.is_known(2.5) and not motion.is_known(3.1) and 'stopped' in motion.problem(3.1)
    level = Rotation.from_matrix(motion.attitude(20.0)).as_euler('ZYX', degrees=True)
    np.testing.assert_allclose(level, [30.0, 0.0, 0.0], atol=0.1)
    for k in range(40, 80):
        motion.add(pose(0.05 * k, tilted, (0.0, 0.0, 0.5)))
    assert not motion.is_known(3.95) and motion.is_frozen


@pytest.mark.parametrize('stated', [True, False])
def test_a_turn_that_ended_in_a_gap_of_odometry_is_no_frozen_attitude(stated):
    """Poses stop for 2 s while the rig turns at 29 deg/s, with its rates or without; when they are back it stands."""
    motion, rate = RigMotion(), 0.5
    for k in range(40):
        motion.add(Pose.level(0.05 * k, 0.05 * k * rate, rate * stated))
    for k in range(80, 160):
        motion.add(Pose.level(0.05 * k, 2.1 * rate))
        assert motion.is_known(0.05 * k) and not motion.is_frozen
    assert motion.jumps == 0


def test_positions_beyond_measure_do_not_move_the_rig():
    """Their differences are not numbers; what comes later counts."""
    motion = RigMotion()
    for k, x in enumerate((0.0, 1e308, 1.1e308, 0.0, 0.0, 0.0)):
        motion.add(Pose(0.02 * k, position=(x, 0.0, 0.0)))
    assert motion.path(0.1) == (0.0, 0.0, 0.0) and 'position' in motion.problem(0.1)
