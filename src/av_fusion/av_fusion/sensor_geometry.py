"""What the sensors report in their own frames, turned into the rig's body frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.frames import FLU_TO_OPTICAL
from av_fusion.measurements import Detection, Hypothesis, Look, Sound
from av_vision.bearing import BearingModel, bearings_of_boxes
from av_vision.camera import PinholeCamera


def sounds_in_body(time: float, directions: Sequence[Sequence[float]], azimuth_variances: Sequence[float],
                   elevation_variances: Sequence[float], confidences: Sequence[float], groups: Sequence[int],
                   rotation: NDArray, window: float) -> list[Sound]:
    """One `Sound` for each ambiguity group, strongest first.

    `directions` (n, 3) are unit vectors in the array's frame, `rotation` (3, 3) turns them into the body frame.
    """
    rows = rotation.tolist()  # for a handful of directions plain numbers are faster
    turned = [tuple(a * x + b * y + c * z for a, b, c in rows) for x, y, z in directions]
    sounds = []
    for group in dict.fromkeys(groups):
        members = [k for k, g in enumerate(groups) if g == group]
        hypotheses = tuple(Hypothesis(math.atan2(y, x), float(azimuth_variances[k]), math.atan2(z, math.hypot(x, y)),
                                      float(elevation_variances[k])) for k in members for x, y, z in (turned[k],))
        sounds.append(Sound(time, hypotheses, max(float(confidences[k]) for k in members), window))
    return sorted(sounds, key=lambda sound: -sound.confidence)


def look_in_body(time: float, camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike,
                 rotation: NDArray, visibility: float = np.nan, model: BearingModel | None = None) -> Look:
    """A picture with boxes (centres and sizes (n, 2) in pixels, scores (n,)) as a `Look`.

    `rotation` (3, 3) turns vectors of the camera's optical frame into the body frame.
    """
    bearings = bearings_of_boxes(camera, centres, sizes, scores, model or BearingModel())
    in_optical = angles_to_direction(bearings.azimuth, bearings.elevation) @ FLU_TO_OPTICAL.T
    azimuths, elevations = direction_to_angles(in_optical @ rotation.T)
    axis, _ = direction_to_angles(rotation[:, 2])
    detections = tuple(Detection(*map(float, values)) for values in zip(
        azimuths, bearings.azimuth_variance, np.ravel(scores), elevations, bearings.elevation_variance, strict=True))
    return Look(time, detections, float(axis), 0.5 * camera.horizontal_fov_rad, visibility)
