"""From the measured projection of a direction on the array's span to angles, with variances, and to a cosine."""

from __future__ import annotations

import math
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
    cosine: of the estimated angle to the axis of a linear array, from -1 to 1. It has no bias at end-fire, where the measured
        one has a skewed error. NaN for other arrays.
    cosine_variance: of its error, reflections included; it does not vanish at end-fire. NaN as the cosine.
    """

    angles: Array
    variances: Array
    cosine: float = math.nan
    cosine_variance: float = math.nan


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
        return Directions(angles, np.full_like(angles, np.inf),
                          *((float(np.clip(q[0], -1.0, 1.0)), math.inf) if array.rank == 1 else ()))
    cosine = cosine_variance = math.nan
    if array.rank == 1:
        alone = covariance if alone is None else alone
        angle, sigma = angle_to_axis(float(q[0]), math.sqrt(alone[0, 0]), math.sqrt(covariance[0, 0]))
        cosine, cosine_variance = math.cos(angle), (sigma * max(math.sin(angle), LEAST_SINE)) ** 2
        points = np.cos([[angle], [min(angle + sigma, np.pi)], [max(angle - sigma, 0.0)]])
    else:
        # beyond the horizon of a plane, as by positions that are stated too small, all points would be on it
        inside = q / max(1.0, float(np.linalg.norm(q))) if array.rank == 2 else q
        eigenvalues, axes = np.linalg.eigh(covariance)
        offsets = (axes * np.sqrt(np.maximum(eigenvalues, 0.0))).T
        points = np.concatenate([inside[None], inside + offsets, inside - offsets])
    angles, *sides = np.moveaxis(np.array(direction_to_angles(array.hypotheses(points))), 1, 0)
    deviations = wrap(np.array(sides) - angles) ** 2
    variances = np.maximum(*np.split(deviations, 2)).sum(axis=0)
    if array.rank == 1:
        variances[1] = np.inf
    return Directions(angles, variances, cosine, cosine_variance)


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
