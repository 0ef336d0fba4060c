"""From the measured projection of a direction on the array's span to angles, with variances, and to a cosine."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import direction_to_angles, wrap
from av_common.microphone_array import MicrophoneArray

Array = NDArray[np.float64]

# Within 15 degrees of the axis of a linear array a small error of the delay becomes a large error of the angle.
END_FIRE_COSINE = float(np.cos(np.radians(15.0)))
LEAST_SINE = 0.05  # of 3 degrees; keeps the variance of a cosine from vanishing at end-fire
# Points at which the posterior density of an angle is evaluated, as shares of its support.
POSTERIOR_GRID = np.linspace(0.0, 1.0, 41)


class Directions(NamedTuple):
    """Mirror-image directions of one measurement.

    angles: azimuths and elevations (2, k) in rad in the array's frame.
    variances: their variances (2, k) in rad^2, inf where the array does not resolve an angle.
    """

    angles: Array
    variances: Array


def undo_delay_curve(array: MicrophoneArray, q: Array, *covariances: Array) -> tuple[Array, tuple[Array, ...]]:
    """Projection q (rank,) and its covariances (rank, rank) with the array's delay curve undone.

    A variance becomes the square of the larger deviation one sigma away: beside an ear the curve is bent within that.

    Parameters:
        array: the microphones.
        q (rank,): measured projection.
        covariances (rank, rank): of what counts as its error.
    """
    curve = array.delay_curve
    if curve is None:
        return q, covariances
    found, sigmas = curve.true_cosine(q), np.sqrt(covariances)
    apart = np.abs([curve.true_cosine(q + side * sigmas) - found for side in (-1.0, 1.0)])
    return found, tuple(apart.max(axis=0) ** 2)


def to_directions(array: MicrophoneArray, q: Array, covariance: Array, alone: Array | None = None) -> Directions:
    """All mirror-image directions of a projection q (rank,) with its covariance (rank, rank).

    The variances come from points one sigma away along the axes of the covariance; of both sides the larger deviation counts.

    Parameters:
        array: the microphones.
        q (rank,): projection of the direction on the basis of the array.
        covariance (rank, rank): its covariance.
        alone (rank, rank): that without reflections, by which the angle to a line is estimated; None for the same.
    """
    if not np.all(np.isfinite(covariance)):
        angles = np.array(direction_to_angles(array.hypotheses(q)))
        return Directions(angles, np.full_like(angles, np.inf))
    if array.rank == 1:
        alone = covariance if alone is None else alone
        angle, sigma = angle_to_axis(float(q[0]), math.sqrt(alone[0, 0]), math.sqrt(covariance[0, 0]))
        axis = array.basis[:, 0]
        if axis[2] == 0.0:  # closed form of the most frequent case
            turn = math.atan2(axis[1], axis[0])
            azimuths = math.remainder(turn - angle, math.tau), math.remainder(turn + angle, math.tau)
            return Directions(np.array([azimuths, (0.0, 0.0)]), np.array([(sigma**2, sigma**2), (np.inf, np.inf)]))
        points = np.cos([[angle], [min(angle + sigma, np.pi)], [max(angle - sigma, 0.0)]])
    else:
        eigenvalues, axes = np.linalg.eigh(covariance)
        offsets = (axes * np.sqrt(np.maximum(eigenvalues, 0.0))).T
        points = np.concatenate([q[None], q + offsets, q - offsets])
    angles, *sides = np.moveaxis(np.array(direction_to_angles(array.hypotheses(points))), 1, 0)
    deviations = wrap(np.array(sides) - angles) ** 2
    variances = np.maximum(*np.split(deviations, 2)).sum(axis=0)
    if array.rank == 1:
        variances[1] = np.inf
    return Directions(angles, variances)


def is_end_fire(array: MicrophoneArray, q: Array) -> bool:
    """Whether a projection q (rank,) lies so close to the axis of a linear array that angles are poorly resolved.

    Parameters:
        array: the microphones.
        q (rank,): projection of the direction on the basis of the array.
    """
    return array.rank == 1 and abs(float(q[0])) > END_FIRE_COSINE


def within_elevations(array: MicrophoneArray, angles: Array, limits: Array) -> NDArray[np.bool_]:
    """Which hypotheses (k,) of angles (2, k) lie in a range of elevation (rad), or are the nearest to it.

    Of two that coincide, in the plane of a planar array, the first is kept.

    Parameters:
        array: the microphones.
        angles (2, k) (rad): azimuths and elevations of the hypotheses.
        limits (2,) (rad): lowest and highest elevation.
    """
    outside = np.maximum(limits[0] - angles[1], angles[1] - limits[1])
    kept: NDArray[np.bool_] = outside <= max(float(outside.min()), 1e-9)
    if array.rank == 2 and np.allclose(angles[:, 0], angles[:, 1], atol=1e-6):
        kept[1] = False
    return kept


def cone_cosine(cosine: float, sigma: float, total_sigma: float) -> tuple[float, float]:
    """Cosine of the estimated angle to the axis of a linear array, and the variance of its error.

    It is the cosine of the posterior mean of the angle. At end-fire the measured cosine has a skewed error, since no true
    cosine lies beyond 1; the estimate has no bias there, and its variance does not vanish.

    Parameters:
        cosine: measured cosine.
        sigma: standard deviation of its error without reflections.
        total_sigma: standard deviation of its error with reflections.
    """
    if not math.isfinite(total_sigma):
        return min(max(cosine, -1.0), 1.0), math.inf
    angle, deviation = angle_to_axis(cosine, sigma, total_sigma)
    return math.cos(angle), (deviation * max(math.sin(angle), LEAST_SINE)) ** 2


@lru_cache(maxsize=4)  # the azimuths and the cosine of a window need the same
def angle_to_axis(cosine: float, sigma: float, total_sigma: float) -> tuple[float, float]:
    """Estimated angle in rad, whose cosine was measured with a normal error, and the root mean square of its error.

    The posterior mean under a uniform prior of the angle. Unlike arccos, it has no bias and no infinite derivative at
    end-fire, and its error over the full circle is 13 % smaller. Away from there it is arccos and sigma / sin. Reflections do
    not move the estimate, as where they shift it is unknown; the error is that about it.

    Parameters:
        cosine: measured cosine.
        sigma: standard deviation of its error without reflections.
        total_sigma: standard deviation of its error with reflections.
    """
    angle, deviation = _posterior(cosine, sigma)
    if total_sigma != sigma:
        mean, deviation = _posterior(cosine, total_sigma)
        deviation = math.hypot(deviation, mean - angle)
    return angle, deviation


def _posterior(cosine: float, sigma: float) -> tuple[float, float]:
    """Posterior mean and standard deviation; see `angle_to_axis`."""
    # Within 5 sigma. A cosine that no angle has, such as 1.03 by an error of the geometry, is seen from one sigma inside.
    nearest = math.acos(min(1.0, max(cosine + 5.0 * sigma, sigma - 1.0)))
    furthest = math.acos(max(-1.0, min(cosine - 5.0 * sigma, 1.0 - sigma)))
    angles = nearest + (furthest - nearest) * POSTERIOR_GRID
    deviations = ((np.cos(angles) - cosine) / max(sigma, 1e-9)) ** 2
    likelihood = np.exp(-0.5 * (deviations - deviations.min()))
    likelihood[[0, -1]] *= 0.5
    likelihood /= likelihood.sum()
    mean = float(likelihood @ angles)
    return mean, float(np.sqrt(likelihood @ (angles - mean) ** 2))
