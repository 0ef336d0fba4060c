"""How a further camera is turned against its description, by what the first one sees at the same time."""

from __future__ import annotations

import math

import numpy as np

from av_common.quaternions import quaternion_of, rotation
from av_fusion.calibration.self_calibration import SelfCalibration
from av_fusion.measurement.measurements import CameraMeasurement
from av_fusion.measurement.vectors import Vector, angles, cross, direction, offset, tangents, turned, turned_back

NAMES = ('roll', 'pitch', 'yaw')
SIGMAS = np.full(3, math.radians(2.0))  # rad, of a careful description, as in `consistency`


class CameraAlignment(SelfCalibration):
    """Estimate of the rotation vector (rad), in the camera's frame, from the camera as described to the camera as it is."""

    def __init__(self) -> None:
        super().__init__(NAMES, SIGMAS, ((math.degrees(1.0), 'deg'),) * len(NAMES))

    def compare(self, time: float, found: Vector, seen: Vector, variance: float) -> bool:
        """Learn from the direction of one thing; returns whether it was used.

        Parameters:
            time (s): capture time.
            found: direction by this camera, in its frame.
            seen: direction by the first one, in the same frame.
            variance (rad^2): of the angle between both, whose error persists.
        """
        left, above = tangents(*angles(found))
        return self.learn(time, [cross(found, left), cross(found, above)], offset(found, left, above, seen), np.zeros(2),
                          np.full(2, variance))

    def corrected(self, measurement: CameraMeasurement) -> CameraMeasurement:
        """The measurement by the camera as it is turned."""
        if not self.compared:
            return measurement
        x, y, z = self.values
        turn, view = rotation(quaternion_of((x, y, z))), measurement.view
        detections = []
        for one in measurement.detections:
            found = turned_back(view, direction(one.azimuth, one.elevation))
            azimuth, elevation = angles(turned(view, turned(turn, found)))
            detections.append(one._replace(azimuth=azimuth, elevation=elevation))
        a, b, c = (turned(view, column) for column in zip(*turn, strict=True))
        return measurement._replace(detections=tuple(detections), view=((a[0], b[0], c[0]), (a[1], b[1], c[1]),
                                                                        (a[2], b[2], c[2])))
