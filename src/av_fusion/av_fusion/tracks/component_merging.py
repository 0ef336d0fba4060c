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
    past = component.at()
    beside, row = past.beside(axis)
    if abs(math.sin(beside)) > 1.3 * math.sqrt(past.variance(row)):  # less than a tenth beyond the axis
        return [component]
    parts = []
    for side in (1.0, -1.0):
        left, shifts, changes = past.beyond(beside, row, ((side, 0.0),), 1.0 - 1e-12)
        part = replace(component, weight=component.weight * float(component.modes @ left), evidence=component.evidence.copy())
        part.weigh_modes(left)
        part.update_moments(past, row, shifts, changes)
        parts.append(part)
    return parts


def are_mergeable(one: GaussianComponent, other: GaussianComponent) -> bool:
    """Whether direction and rates of both agree within their standard deviations, so that their sum has one peak."""
    if one.on_rig != other.on_rig:
        return False
    across, up = _offset(one, other)
    variances = one.covariance.diagonal() + other.covariance.diagonal()
    return bool(across**2 < variances[0] and up**2 < 2.0 * variances[1]
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
    modes = a * one.modes + b * here.modes
    share = (b * here.modes / modes)[:, None]
    apart = here.offsets + difference - one.offsets
    spread = (share * (1.0 - share) * apart)[:, :, None] * apart[:, None, :]
    one.covariances = (1.0 - share)[..., None] * one.covariances + share[..., None] * here.covariances + spread
    one.offsets, one.modes = one.offsets + share * apart, modes
    one.p_unheard = a * one.p_unheard + b * other.p_unheard
    one.elevation_measured = one.elevation_measured or other.elevation_measured
    one.weight = total
    one.recentre()


def _offset(one: GaussianComponent, other: GaussianComponent) -> tuple[float, float]:
    """Where the mean of another component is in the plane of one, across and up (rad)."""
    return offset(one.direction, *tangents(one.azimuth, one.elevation), other.direction)
