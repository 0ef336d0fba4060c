"""Components of a mixture that become one, or two."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from av_fusion.measurement.vectors import Vector, offset, tangents
from av_fusion.tracks.component import GaussianComponent


def split(component: GaussianComponent, axis: Vector) -> list[GaussianComponent]:
    """A component split in two if it extends to both sides of the vertical plane of an axis, else alone.

    A measurement of a target near end-fire fits both sides, which one Gaussian cannot represent. The parts are truncated
    normal distributions, approximated by Gaussians.

    Parameters:
        component: the component.
        axis: unit vector of the axis in the world.
    """
    past = component.at(0.0)
    beside, row = past.beside(axis)
    variance = past.variance(row)
    sigma = math.sqrt(variance)
    if abs(math.sin(beside)) > 1.3 * sigma:  # less than a tenth beyond the axis
        return [component]
    parts = []
    for side in (1.0, -1.0):
        start = side * beside / sigma
        inside = 0.5 * math.erfc(-start / math.sqrt(2.0))
        pull = math.exp(-0.5 * start * start) / math.sqrt(2.0 * math.pi) / inside
        part = replace(component, weight=component.weight * inside, evidence=component.evidence.copy())
        part.shift(past, row, variance, side * sigma * pull, -variance * pull * (pull + start))
        parts.append(part)
    return parts


def are_mergeable(one: GaussianComponent, other: GaussianComponent) -> bool:
    """Whether direction and rates of both agree within their standard deviations, so that their sum has one peak."""
    across, up = _offset(one, other)
    variances = one.covariance.diagonal() + other.covariance.diagonal()
    return bool(across**2 < variances[0] and up**2 < 9.0 * variances[1]
                and (other.across_rate - one.across_rate) ** 2 < variances[2]
                and (other.up_rate - one.up_rate) ** 2 < 9.0 * variances[3])


def merge(one: GaussianComponent, other: GaussianComponent) -> None:
    """Merge another component into one, preserving the moments of the sum; the heavier one's support is kept."""
    if other.weight > one.weight:
        one.newest_doa, one.newest_sighting, one.evidence = other.newest_doa, other.newest_sighting, other.evidence
    total = one.weight + other.weight
    a, b = one.weight / total, other.weight / total
    across, up = _offset(one, other)
    here = replace(other)
    here.move(*_offset(other, one))
    difference = np.array([across, up, here.across_rate - one.across_rate, here.up_rate - one.up_rate,
                           here.inverse_range - one.inverse_range])
    one.covariance = a * one.covariance + b * here.covariance + a * b * difference[:, None] * difference
    across, up, across_rate, up_rate, inverse_range = (b * difference).tolist()
    one.across_rate += across_rate
    one.up_rate += up_rate
    one.inverse_range += inverse_range
    one.p_unheard = a * one.p_unheard + b * other.p_unheard
    one.elevation_measured = one.elevation_measured or other.elevation_measured
    one.weight = total
    one.move(across, up)


def _offset(one: GaussianComponent, other: GaussianComponent) -> tuple[float, float]:
    """Where the mean of another component is in the plane of one, across and up (rad)."""
    return offset(one.direction, *tangents(one.azimuth, one.elevation), other.direction)
