"""What compares sound and sight with the rig's description."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.rig import CAMERAS
from av_fusion.consistency.camera_monitor import CameraMonitor
from av_fusion.consistency.monitor import ConsistencyMonitor
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import angles, turned_back


def test_what_is_heard_at_the_zenith_is_compared_with_the_description():
    """Of a tilted rig the vertical part of a direction there may be 1 and a digit."""
    random = np.random.default_rng(0)
    for _ in range(100):
        q, motion = random.normal(size=4) * (1.0, 0.1, 0.1, 1.0), RigMotion()
        for time in (99.0, 100.0, 101.0):
            motion.add(Pose(time, tuple((q / np.linalg.norm(q)).tolist())))
        monitor = ConsistencyMonitor(motion)
        azimuth, elevation = angles(turned_back(motion.attitude(100.0), (0.0, 0.0, 1.0)))
        monitor.add_doas([DoaMeasurement(100.0, (Hypothesis(azimuth, 1e-3, elevation, 1e-3),), 0.9, 0.1)])
        assert monitor.advance(101.0) is None


@pytest.mark.parametrize('failing', [True, False])
def test_an_array_that_is_a_pair_for_a_while_is_compared_on(failing):
    """Of three microphones one fails, or comes late: what was a direction is a cone, and the other way round."""
    motion = RigMotion()
    monitor = ConsistencyMonitor(motion)
    for step in range(150):
        time = 100.0 + 0.1 * step
        motion.add(Pose.level(time, 0.2 * math.sin(time)))
        azimuth = 0.3 - 0.2 * math.sin(time)
        monitor.add_camera(CameraMeasurement(time, (Detection(azimuth, 1e-4, 0.9, 0.1, 1e-4),)))
        if (50 < step < 60) == failing:
            heard = DoaMeasurement.of_cone(time, Cone((0.0, 1.0, 0.0), math.sin(azimuth), 1e-3), 0.9, 0.1)
        else:
            heard = DoaMeasurement(time, (Hypothesis(azimuth, 1e-3, 0.1, 1e-3),), 0.9, 0.1)
        monitor.add_doas([heard])
        assert monitor.advance(time) is None and all(map(math.isfinite, monitor.belief))
    assert monitor.belief.in_body < math.radians(1.0) ** 2


def test_sightings_of_before_a_step_of_the_clock_back_are_not_used_when_their_time_comes_again():
    """Before anything was heard they wait."""
    motion, image = RigMotion(), CameraMeasurement(0.0, (Detection(0.3, 1e-4, 0.9, 0.1, 1e-4),))
    monitor, used = CameraMonitor(motion, CAMERAS[0], 0.0, 0.0), []
    for time in (50.0, 30.0):
        monitor.add_camera(image._replace(time=time))
        monitor.advance(time)
    for step in range(300):
        time = 30.0 + 0.1 * step
        motion.add(Pose.level(time, 0.0))
        monitor.add_doas([DoaMeasurement(time, (Hypothesis(0.3, 1e-3, 0.1, 1e-3),), 0.9, 0.1)])
        monitor.advance(time)
        used.append(monitor.seen)
    assert max(used) == 30.0
