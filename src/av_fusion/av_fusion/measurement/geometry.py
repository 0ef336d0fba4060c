"""Directions from sensor frames to the rig's body frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, UNIT_TOLERANCE
from av_common.stamps import to_seconds
from av_fusion.measurement.measurements import (
    COSINE_TOLERANCE,
    Cone,
    Detection,
    DoaMeasurement,
    Hypothesis,
)
from av_fusion.measurement.vectors import ZERO, Rows, Vector, angles, direction, rows_of, turned
from av_interfaces.msg import Doa, DoaArray, DoaOdds
from av_vision.bearing import bearings_of_boxes

OVERHEAD = 0.95  # vertical part of a direction close to the array's vertical
MOST_DIRECTIONS = 32  # of a window, the strongest first: eight images of four sources; more are not doa_node's
LARGEST_ODDS = 1e9  # of a message: a source is never as sure
LEVEL = math.cos(math.radians(1.0))  # horizontal part of an axis that counts as level


def doa_in_body(message: DoaArray, rotation: NDArray[np.float64], odds: tuple[float, ...] = ()) -> list[DoaMeasurement]:
    """One measurement for each ambiguity group of a message, most confident first.

    A linear array (one with an axis) measures cones, other arrays directions. `rotation` (3, 3) turns vectors of the
    array's frame into the body frame.

    Parameters:
        message: the directions.
        rotation (3, 3): rotation matrix from the array's frame to the body frame.
        odds: of the strongest source, see `usable_odds`; empty where unknown.

    Raises ValueError for an impossible stamp, and for an axis that is neither a unit vector nor zero.
    """
    rows = rows_of(rotation)
    length = math.hypot(message.axis.x, message.axis.y, message.axis.z)
    if not (length == 0.0 or abs(length * length - 1.0) < UNIT_TOLERANCE):
        raise ValueError(f'axis of length {length:g}, expected a unit vector, or zero without an axis')
    time, axis = to_seconds(message.header.stamp), turned(rows, (message.axis.x, message.axis.y, message.axis.z))
    groups: dict[int, list[Doa]] = {}
    for hypothesis in message.hypotheses[:MOST_DIRECTIONS]:
        groups.setdefault(hypothesis.ambiguity_group, []).append(hypothesis)
    measurements = []
    for group, members in groups.items():
        cone = _cone_of(axis, members)
        if cone is not None and math.hypot(axis[0], axis[1]) < LEVEL:
            hypotheses: tuple[Hypothesis, ...] = cone.images()  # the array's level images are not level in the body
        else:
            hypotheses = tuple([_hypothesis_of(rows, member) for member in members])
        confidence = max([member.confidence for member in members])
        sound = members[0]
        judged, known = 0.0 < sound.drone_probability <= 1.0, 0.0 < sound.fundamental < math.inf
        measurements.append(DoaMeasurement(
            time, hypotheses, confidence, message.window, cone, sound.drone_probability if judged else math.nan,
            sound.fundamental if known else math.nan, sound.fundamental_variance if known else math.nan,
            odds if group == 0 and cone is not None else ()))
    return sorted(measurements, key=lambda measurement: -measurement.confidence)


def usable_odds(message: DoaOdds) -> tuple[float, ...]:
    """The odds over the cosine of a message. Raises ValueError for impossible ones."""
    odds = np.asarray(message.odds, float)
    if not ((odds >= 0.0) & (odds <= LARGEST_ODDS)).all():
        raise ValueError(f'odds from {odds.min():g} to {odds.max():g}, expected 0 to {LARGEST_ODDS:g}')
    return tuple(odds.tolist())


def _cone_of(axis: Vector, images: Sequence[Doa]) -> Cone | None:
    """The cone whose images are two hypotheses, with an axis in the body frame; None when there is no cone."""
    if len(images) != 2 or axis == ZERO or not math.isfinite(images[0].cosine):
        return None
    cosine = images[0].cosine
    if abs(cosine) <= 1.0 + COSINE_TOLERANCE:  # otherwise an error of the sender, which is refused later
        cosine = min(max(cosine, -1.0), 1.0)
    return Cone(axis, cosine, images[0].cosine_variance)


def _hypothesis_of(rows: Rows, doa: Doa) -> Hypothesis:
    found = (doa.direction.x, doa.direction.y, doa.direction.z)
    azimuth, elevation = angles(turned(rows, found))
    length = math.hypot(*found) or 1.0
    across = doa.azimuth_variance * (math.hypot(found[0], found[1]) / length)**2
    if abs(found[2]) > OVERHEAD * length:  # where the azimuth has no meaning, the error across is that of the elevation
        across = max(across, min(doa.elevation_variance, doa.azimuth_variance))
    return Hypothesis(azimuth, across, elevation, doa.elevation_variance)


def detections_in_body(camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike,
                       rotation: NDArray[np.float64]) -> list[Detection]:
    """The boxes of an image as directions.

    Parameters:
        camera: intrinsics of the camera.
        centres, sizes (n, 2; pixels), scores (n,): boxes of the detections.
        rotation (3, 3): turns vectors of the camera's optical frame into the body frame.
    """
    columns = (*bearings_of_boxes(camera, centres, sizes, scores), np.ravel(scores))
    rows = rows_of(rotation @ FLU_TO_OPTICAL)
    detections = []
    for azimuth, elevation, variance, elevation_variance, score in zip(*(column.tolist() for column in columns), strict=True):
        found, climb = angles(turned(rows, direction(azimuth, elevation)))
        detections.append(Detection(found, variance * math.cos(elevation)**2, score, climb, elevation_variance))
    return detections
