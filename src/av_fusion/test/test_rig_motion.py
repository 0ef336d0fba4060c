"""The rig's yaw at any instant."""

from __future__ import annotations

import math

import pytest

from av_common.angles import wrap
from av_fusion.measurement.rig_motion import RigMotion


def test_interpolates_across_the_seam_and_extrapolates_by_rate():
    """A steady turn through +-180 degrees is linear in time."""
    motion, rate = RigMotion(), 1.0
    for k in range(100):
        motion.add(0.1 * k, float(wrap(3.0 + rate * 0.1 * k)), rate)
    for time in (0.05, 0.14, 0.17, 5.55, 9.9, 10.1):
        assert abs(wrap(motion.yaw(time) - (3.0 + rate * time))) < 1e-9
    assert motion.yaw_rate(5.0) == rate


def test_without_poses_the_rig_stands_still():
    """A rig without odometry counts as fixed."""
    assert RigMotion().yaw(123.0) == 0.0 and RigMotion().yaw_rate(5.0) == 0.0


def test_bad_and_late_poses_are_ignored_and_a_restart_is_accepted():
    """NaN, repeated and reordered poses change nothing; a clock that restarts empties the buffer."""
    motion = RigMotion(keep_s=5.0)
    motion.add(100.0, 0.5)
    for time, yaw in ((math.nan, 0.0), (101.0, math.inf), (100.0, 2.0), (99.0, 2.0)):
        motion.add(time, yaw)
    assert motion.yaw(100.0) == pytest.approx(0.5)
    motion.add(3.0, 1.5)
    assert motion.newest == 3.0 and motion.yaw(3.0) == pytest.approx(1.5)


def test_memory_is_bounded():
    """Hours of poses leave seconds in the buffer."""
    motion = RigMotion(keep_s=2.0)
    for k in range(20000):
        motion.add(0.01 * k, 0.0)
    assert len(motion._times) <= 2 * 2.0 / 0.01 + 2
