"""What the sensors report in their own frames, turned into the rig's body frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement, Hypothesis
from av_vision.bearing import BearingModel, bearings_of_boxes


def doa_in_body(time: float, directions: Sequence[Sequence[float]], azimuth_variances: Sequence[float],
                elevation_variances: Sequence[float], confidences: Sequence[float], groups: Sequence[int],
                rotation: NDArray, window: float) -> list[DoaMeasurement]:
    """One `DoaMeasurement` for each ambiguity group, strongest first.

    `directions` (n, 3) are unit vectors in the array's frame, `rotation` (3, 3) turns them into the body frame.
    """
    rows = rotation.tolist()
    members: dict[int, list[Hypothesis]] = {}
    surest: dict[int, float] = {}
    for direction, variance, elevation_variance, confidence, group in zip(
            directions, azimuth_variances, elevation_variances, confidences, groups, strict=True):
        x, y, z = _turned(rows, direction)
        members.setdefault(group, []).append(Hypothesis(math.atan2(y, x), float(variance), math.atan2(z, math.hypot(x, y)),
                                                        float(elevation_variance)))
        surest[group] = max(float(confidence), surest.get(group, 0.0))
    sounds = [DoaMeasurement(time, tuple(hypotheses), surest[group], window) for group, hypotheses in members.items()]
    return sorted(sounds, key=lambda sound: -sound.confidence)


def camera_in_body(time: float, camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike,
                   rotation: NDArray, visibility: float = np.nan, model: BearingModel | None = None) -> CameraMeasurement:
    """A picture with boxes (centres and sizes (n, 2) in pixels, scores (n,)) as a `CameraMeasurement`.

    `rotation` (3, 3) turns vectors of the camera's optical frame into the body frame.
    """
    found = detections_in_body(camera, centres, sizes, scores, rotation, model)
    return CameraMeasurement(time, tuple(found), view_azimuth(rotation), 0.5 * camera.horizontal_fov_rad, visibility)


def view_azimuth(rotation: NDArray[np.float64]) -> float:
    """Body azimuth (rad) of the optical axis, from the rotation (3, 3) of the optical frame to the body frame."""
    return math.atan2(rotation[1, 2], rotation[0, 2])


def detections_in_body(camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike, rotation: NDArray,
                       model: BearingModel | None = None) -> list[Detection]:
    """The same boxes one by one."""
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


def _turned(rows: list[list[float]], vector: Sequence[float]) -> tuple[float, float, float]:
    """A rotation (3, 3) of one vector: for a handful of directions plain numbers are faster than arrays."""
    x, y, z = vector
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
