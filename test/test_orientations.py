"""Every part of the rig takes the same quaternions for orientations: none moves on an attitude that another one refuses."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry

from av_common.frames import BASE_FRAME, is_orientation
from av_common.gimbal_history import sample_of
from av_common.rig import load_rig
from av_common.stamps import to_stamp
from av_fusion.measurement.converter import pose_of
from av_interfaces.msg import GimbalState
from av_pointing.gimbal_stage import GimbalStage
from av_px4.odometry import pose_from_px4
from av_sim_bridge.messages import vehicle_state
from av_sim_bridge.wire.gimbal import GimbalSample, decode_gimbal, encode_gimbal
from av_simulator import find_config
from av_vision.stage import DetectionStage

START = 1000.0


def odometry(q):
    message = Odometry()
    message.header.stamp, message.pose.pose.orientation = to_stamp(START), Quaternion(w=q[0], x=q[1], y=q[2], z=q[3])
    return message


def gimbal_state(q):
    message = GimbalState(orientation=Quaternion(w=q[0], x=q[1], y=q[2], z=q[3]), source=GimbalState.SOURCE_FEEDBACK)
    message.header.frame_id = BASE_FRAME
    return message


DECIDED = {
    'pose_of': lambda q: pose_of(odometry(q)),
    'GimbalStage': lambda q: GimbalStage(load_rig(find_config('rig_gimbal'))).on_odometry(odometry(q), START) or True,
    'sample_of': lambda q: sample_of(gimbal_state(q)), 'vehicle_state': lambda q: vehicle_state(odometry(q)),
    'decode_gimbal': lambda q: decode_gimbal(encode_gimbal(GimbalSample(0, 1.0, np.array(q), 0.1))),
    'DetectionStage': lambda q: DetectionStage(None).on_odometry(odometry(q)) or True,
    'pose_from_px4': lambda q: pose_from_px4(np.zeros(3), q, np.zeros(3), np.zeros(3))}


@pytest.mark.parametrize('decide', DECIDED)
@pytest.mark.parametrize(('norm', 'taken'), [
    (1.0, True), (0.996, True), (1.004, True), (0.994, False), (1.006, False), (0.0, False), (1e200, False), (np.nan, False)])
def test_one_rule_says_what_an_orientation_is(decide, norm, taken):
    quaternion = tuple((norm * np.array([0.5, -0.5, 0.5, -0.5])).tolist())
    assert is_orientation(quaternion) == taken
    found = None
    with contextlib.suppress(ValueError, OverflowError):    # no number of a datagram
        found = DECIDED[decide](quaternion)
    assert (found is not None) == taken
