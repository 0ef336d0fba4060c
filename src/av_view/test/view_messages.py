"""Messages of a rig that is looked at."""

from __future__ import annotations

import math

from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_common.stamps import to_stamp
from av_fusion.measurement.measurements import DoaMeasurement, Hypothesis
from av_interfaces.msg import Bearing, DoaArray
from av_view.camera_view import CameraView

NOW = 100.0


def camera(yaw=0.0):
    """A level camera of 640 by 480 pixels and 70 degrees that looks to the left by a yaw (rad)."""
    return CameraView(PinholeCamera.from_fov(640, 480, math.radians(70.0)), rotation_from_rpy(0.0, 0.0, yaw) @ FLU_TO_OPTICAL.T)


CAMERA = camera()


def bearing(**values):
    message = Bearing(state=Bearing.STATE_ACOUSTIC_ACTIVE, source=Bearing.SOURCE_SOUND, azimuth=0.1, azimuth_variance=0.0004,
                      elevation_variance=math.inf, range=math.nan, range_variance=math.inf, hemisphere_probability=0.7,
                      measured=to_stamp(NOW - 0.2), attitude_known=True, azimuth_world=0.5)
    message.header.stamp = to_stamp(values.pop('stamp', NOW - 0.1))
    for name, value in values.items():
        setattr(message, name, value)
    return message


def heard(azimuths=(0.1, math.pi - 0.1), variance=0.001, confidence=0.9, level=-40.0):
    message = DoaArray(level=level, method='gcc_phat')
    message.header.stamp = to_stamp(NOW - 0.1)
    return message, [DoaMeasurement(NOW - 0.1, tuple(Hypothesis(a, variance) for a in azimuths), confidence)]


def seen(x, y, width=40.0, height=20.0, score=0.8):
    hypothesis = ObjectHypothesisWithPose()
    hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = 'drone', score
    detection = Detection2D(results=[hypothesis], id='3')
    detection.bbox.center.position.x, detection.bbox.center.position.y = x, y
    detection.bbox.size_x, detection.bbox.size_y = width, height
    message = Detection2DArray(detections=[detection])
    message.header.stamp = to_stamp(NOW - 0.1)
    return message


def pose(x, y, z, yaw=0.0):
    message = Odometry()
    message.pose.pose.position.x, message.pose.pose.position.y, message.pose.pose.position.z = x, y, z
    message.pose.pose.orientation = Quaternion(w=math.cos(yaw / 2), z=math.sin(yaw / 2))
    return message
