"""Where other rigs have a target decides between mirror images, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped, Vector3
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from av_common.parameters import node_parameters
from av_common.stamps import to_stamp
from av_fusion.measurement.converter import fixed_rotations
from av_fusion.stage import make_fusion_stage
from av_interfaces.msg import Doa, DoaArray

START, YAW, BEHIND = 1000.0, 0.4, math.radians(140.0)


def doa(stamp, azimuth):
    """A direction of arrival of a pair along y, with its mirror image."""
    images = [Doa(direction=Vector3(x=math.cos(a), y=math.sin(a), z=0.0), azimuth=a, azimuth_variance=2e-3,
                  elevation_variance=math.inf, cosine=math.sin(a), cosine_variance=2e-3 * math.cos(a)**2, confidence=0.9)
              for a in (azimuth, math.pi - azimuth)]
    return DoaArray(header=Header(stamp=to_stamp(stamp), frame_id='microphones'), window=0.5, method='test',
                    axis=Vector3(x=0.0, y=1.0, z=0.0), hypotheses=images)


def cue(stamp, azimuth_world, frame='rig/world'):
    point = Point(x=60.0 * math.cos(azimuth_world), y=60.0 * math.sin(azimuth_world), z=10.0)
    return PointStamped(header=Header(stamp=to_stamp(stamp), frame_id=frame), point=point)


def run(seconds, cued=None, frame='rig/world'):
    """Outputs of a rig at YAW that hears a target BEHIND, and is told of one at `cued` (rad) in its last second."""
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'),
                              fixed_rotations({'microphones': np.eye(3)}))
    output = None
    for step in range(round(10 * seconds)):
        now = START + 0.1 * step
        pose = Odometry(header=Header(stamp=to_stamp(now)))
        pose.pose.pose.orientation.w, pose.pose.pose.orientation.z = math.cos(0.5 * YAW), math.sin(0.5 * YAW)
        stage.on_odometry(pose, now)
        if cued is not None and step >= 10 * (seconds - 1.0):
            stage.on_cue(cue(now, cued, frame), now)
        output = stage.on_doa(doa(now, BEHIND), now)
    return output


@pytest.mark.parametrize('side', [BEHIND, math.pi - BEHIND])
def test_a_cue_decides_the_side_at_once(side):
    """Within a second, and with the precision that the rig has by itself."""
    alone, told = run(4.0), run(4.0, side + YAW)
    assert not alone.bearing.resolved and told.bearing.resolved
    assert math.cos(told.bearing.azimuth - side) > 0.99
    assert told.bearing.azimuth_variance == pytest.approx(alone.bearing.azimuth_variance, rel=0.05)


def test_a_cue_to_another_target_decides_nothing():
    """It fits neither image."""
    told = run(4.0, -1.2 + YAW)
    assert not told.bearing.resolved and 0.3 < told.bearing.hemisphere_probability < 0.7


def test_an_order_to_look_is_no_evidence():
    """One in the frame of the body."""
    assert not run(4.0, BEHIND, 'base_link').bearing.resolved


def test_a_cue_makes_no_target():
    """Without anything heard there is none."""
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), fixed_rotations({}))
    stage.on_cue(cue(START, 0.5), START)
    assert stage.on_time(START + 0.1).bearing.state == 0


def test_cues_of_another_clock_or_without_a_place_are_refused():
    """With what is wrong."""
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), fixed_rotations({}))
    for stamp in (START - 5.0, START + 1.0):
        with pytest.raises(ValueError, match='stamp of a cue'):
            stage.on_cue(cue(stamp, 0.5), START)
    with pytest.raises(ValueError, match='cue at'):
        stage.on_cue(cue(START, math.nan), START)
