"""Directions from sensor frames to the rig's body frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL
from av_common.stamps import to_seconds
from av_fusion.measurement.measurements import (
    COSINE_TOLERANCE,
    CameraMeasurement,
    Cone,
    Detection,
    DoaMeasurement,
    Hypothesis,
)
from av_interfaces.msg import Doa, DoaArray
from av_vision.bearing import BearingModel, bearings_of_boxes

UNIT_TOLERANCE = 0.01  # of the length of an axis
LEAST_LEVEL = 0.1  # horizontal part of an axis; an axis closer to the vertical does not measure azimuth
LEVEL = math.cos(math.radians(1.0))  # horizontal part of an axis that counts as level

_Rows = list[list[float]]  # of a rotation matrix: for a few directions plain numbers are faster than arrays


def doa_in_body(message: DoaArray, rotation: NDArray[np.float64]) -> list[DoaMeasurement]:
    """One measurement for each ambiguity group of a message, most confident first.

    A linear array (one with an axis) measures cones, other arrays directions. `rotation` (3, 3) turns vectors of the
    array's frame into the body frame.

    Parameters:
        message: the directions.
        rotation (3, 3): rotation matrix from the array's frame to the body frame.

    Raises ValueError for an impossible stamp, and for an axis that is neither a unit vector nor zero.
    """
    rows = rotation.tolist()
    length = math.hypot(message.axis.x, message.axis.y, message.axis.z)
    if not (length == 0.0 or abs(length - 1.0) < UNIT_TOLERANCE):
        raise ValueError(f'axis of length {length:g}, expected a unit vector, or zero without an axis')
    time, axis = to_seconds(message.header.stamp), _turned(rows, (message.axis.x, message.axis.y, message.axis.z))
    groups: dict[int, list[Doa]] = {}
    for hypothesis in message.hypotheses:
        groups.setdefault(hypothesis.ambiguity_group, []).append(hypothesis)
    measurements = []
    for members in groups.values():
        cone = _cone_of(axis, members)
        if cone is not None and math.hypot(axis[0], axis[1]) < LEVEL:
            hypotheses: tuple[Hypothesis, ...] = cone.images()  # the array's level images are not level in the body
        else:
            hypotheses = tuple(_hypothesis_of(rows, member) for member in members)
        confidence = max(member.confidence for member in members)
        measurements.append(DoaMeasurement(time, hypotheses, confidence, message.window, cone))
    return sorted(measurements, key=lambda measurement: -measurement.confidence)


def _cone_of(axis: Sequence[float], images: Sequence[Doa]) -> Cone | None:
    """The cone whose images are two hypotheses, with an axis in the body frame; None when there is no cone.

    Targets are assumed to be far below 90 degrees of elevation, so that only the horizontal part of a tilted axis matters.
    """
    level = math.hypot(axis[0], axis[1])
    if len(images) != 2 or level < LEAST_LEVEL or not math.isfinite(images[0].cosine):
        return None
    cosine = images[0].cosine
    if abs(cosine) <= 1.0 + COSINE_TOLERANCE:  # otherwise an error of the sender, which is refused later
        cosine = min(max(cosine / level, -1.0), 1.0)
    return Cone(math.atan2(axis[1], axis[0]), cosine, images[0].cosine_variance / level**2)


def _hypothesis_of(rows: _Rows, doa: Doa) -> Hypothesis:
    x, y, z = _turned(rows, (doa.direction.x, doa.direction.y, doa.direction.z))
    return Hypothesis(math.atan2(y, x), doa.azimuth_variance, math.atan2(z, math.hypot(x, y)), doa.elevation_variance)


def camera_in_body(time: float, camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike,
                   rotation: NDArray[np.float64], visibility: float = math.nan, model: BearingModel | None = None
                   ) -> CameraMeasurement:
    """The measurement of one image.

    Parameters:
        time (s): capture time.
        camera: intrinsics of the camera.
        centres, sizes (n, 2; pixels), scores (n,): boxes of the detections.
        rotation (3, 3): turns vectors of the camera's optical frame into the body frame.
        visibility: visibility 0..1, NaN if unknown.
        model: errors of boxes.
    """
    found = detections_in_body(camera, centres, sizes, scores, rotation, model)
    return CameraMeasurement(time, tuple(found), view_azimuth(rotation), 0.5 * camera.horizontal_fov_rad, visibility)


def view_azimuth(rotation: NDArray[np.float64]) -> float:
    """Body azimuth (rad) of the optical axis, from the rotation (3, 3) of the optical frame to the body frame."""
    return math.atan2(rotation[1, 2], rotation[0, 2])


def detections_in_body(camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike,
                       rotation: NDArray[np.float64], model: BearingModel | None = None) -> list[Detection]:
    """The boxes of an image as directions; arguments as for `camera_in_body`."""
    bearings = bearings_of_boxes(camera, centres, sizes, scores, model or BearingModel())
    rows = (rotation @ FLU_TO_OPTICAL).tolist()
    columns = (bearings.azimuth, bearings.elevation, bearings.azimuth_variance, bearings.elevation_variance, np.ravel(scores))
    detections = []
    for azimuth, elevation, variance, elevation_variance, score in zip(*(column.tolist() for column in columns), strict=True):
        level = math.cos(elevation)
        direction = (level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation))
        x, y, z = _turned(rows, direction)
        detections.append(Detection(math.atan2(y, x), variance, score, math.atan2(z, math.hypot(x, y)), elevation_variance))
    return detections


def _turned(rows: _Rows, vector: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = vector
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
