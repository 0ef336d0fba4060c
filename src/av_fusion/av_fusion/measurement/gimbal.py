"""What a camera on a gimbal sees, at the orientation of its capture time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from av_common.gimbal_history import GimbalHistory
from av_fusion.measurement.converter import RotationOf
from av_fusion.measurement.measurements import CameraMeasurement, Detection


def gimbal_rotations(fixed: Mapping[str, NDArray[np.float64]], carried: Mapping[str, NDArray[np.float64]],
                     history: GimbalHistory) -> RotationOf:
    """Rotations of the sensors of a rig with a gimbal, where there is no tf. Raises NotYetKnownError as the history does.

    Parameters:
        fixed (3, 3): rotation matrices into the body, by the name of the sensor's frame.
        carried (3, 3): those into the gimbal's frame, of sensors on the gimbal.
        history: orientations of the gimbal.
    """
    def rotation_of(frame: str, time: float) -> NDArray[np.float64] | None:
        if frame not in carried:
            return fixed.get(frame)
        sample = history.at(time)
        return None if sample is None else sample.rotation @ carried[frame]

    return rotation_of


def blurred(measurement: CameraMeasurement, variance: float) -> CameraMeasurement:
    """A measurement by a camera whose orientation has an error.

    Parameters:
        measurement: the measurement, at the most probable orientation.
        variance (rad^2): of the orientation's error about each axis.
    """
    detections = tuple(_blurred(detection, variance) for detection in measurement.detections)
    return measurement._replace(detections=detections) if variance > 0.0 else measurement


def _blurred(detection: Detection, variance: float) -> Detection:
    return detection._replace(across_variance=detection.across_variance + variance,
                              elevation_variance=detection.elevation_variance + variance)
