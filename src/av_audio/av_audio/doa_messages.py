"""Directions of arrival as `av_interfaces/DoaArray` messages."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Vector3
from numpy.typing import NDArray
from std_msgs.msg import Header

from av_audio.localizer import DoaEstimate
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_common.stamps import to_stamp
from av_interfaces.msg import Doa, DoaArray

LEAST_SLOPE = 0.05  # of the cosine over the angle: close to the axis the variance of the cosine does not vanish


def doa_array(estimate: DoaEstimate, array: MicrophoneArray, stamp: float, frame_id: str, window: float, method: str
              ) -> DoaArray:
    """The message of one analysis window.

    Parameters:
        estimate: directions in the array's frame.
        array: microphones that took the sound; a linear array gives `axis`, `cosine` and `cosine_variance`.
        stamp (s): capture time of the window's centre.
        frame_id: the array's frame.
        window (s): length of the window.
        method: name of the estimator.
    """
    directions = angles_to_direction(estimate.azimuth, estimate.elevation).reshape(-1, 3)
    axis = array.basis[:, 0] if array.rank == 1 else np.zeros(3)
    cosines, variances = cosines_to_axis(directions, estimate.azimuth_variance, axis)
    columns = (estimate.azimuth, estimate.elevation, estimate.azimuth_variance, estimate.elevation_variance, cosines,
               variances, estimate.confidence)
    names = ('azimuth', 'elevation', 'azimuth_variance', 'elevation_variance', 'cosine', 'cosine_variance', 'confidence')
    hypotheses = [Doa(direction=_vector(directions[k]), ambiguity_group=int(estimate.group[k]),
                      end_fire=bool(estimate.end_fire[k]),
                      **{name: float(column[k]) for name, column in zip(names, columns, strict=True)})
                  for k in range(len(directions))]
    return DoaArray(header=Header(stamp=to_stamp(stamp), frame_id=frame_id), window=window, method=method,
                    level=float(estimate.level_dbfs), axis=_vector(axis), hypotheses=hypotheses)


def cosines_to_axis(directions: NDArray, azimuth_variances: NDArray, axis: NDArray) -> tuple[NDArray, NDArray]:
    """Cosines (n,) of the angles between directions (n, 3) and an axis (3,), and their variances; NaN for a zero axis."""
    if not axis.any():
        unknown = np.full(len(directions), math.nan)
        return unknown, unknown
    level = math.hypot(axis[0], axis[1])
    slopes = np.abs(directions[:, :2] @ [-axis[1], axis[0]])  # d cosine / d azimuth of horizontal directions
    return directions @ axis, np.maximum(slopes, LEAST_SLOPE * level) ** 2 * np.asarray(azimuth_variances)


def _vector(values: NDArray) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)
