"""What measurements that a component has accepted say of its direction, apart from the filter's own state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from av_fusion.measurement.vectors import ZERO, Vector, angles, combined, dot, tangents
from av_fusion.measurement.vectors import direction as direction_of

LONGEST_S = 0.6  # over which a direction moves uniformly: between reports, twice a second at least
LEAST_INFORMATION = 1e-3  # 1/rad^2, beside which nothing counts as measured


class Evidence(NamedTuple):
    """A scalar measurement of a direction: where it is along an arc from a known one.

    Parameters:
        time (s): its capture time.
        seen: whether by the camera.
        direction: where the arc begins, in the world.
        normal: the arc's direction there, a unit vector.
        value (rad), variance (rad^2): of the arc's length.
    """

    time: float
    seen: bool
    direction: Vector
    normal: Vector
    value: float
    variance: float


class Increment(NamedTuple):
    """The product of the likelihoods of some measurements: a normal density of the direction.

    Parameters:
        time (s): mean capture time, by information.
        seen: whether they are of the camera; if so, what was heard meanwhile is left out, as sound arrives later.
        azimuth, elevation (rad): where it is largest, in the world.
        hh, hv, vv (1/rad^2): its information across and up.
    """

    time: float
    seen: bool
    azimuth: float
    elevation: float
    hh: float
    hv: float
    vv: float


def increment(evidence: Sequence[Evidence], rate: Vector) -> Increment | None:
    """What measurements of a short time say together; None where there are none.

    The information filter's increment (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
    Navigation, 2001, section 7.2). The target's own motion within that time is taken out to first order, about the mean time.

    Parameters:
        evidence: the measurements.
        rate (rad/s): of the direction, a vector in the world.
    """
    newest = max((one.time for one in evidence), default=0.0)
    recent = [one for one in evidence if newest - one.time < LONGEST_S]
    if not recent:
        return None
    seen = any(one.seen for one in recent)
    used = [one for one in recent if one.seen == seen]
    total = sum(1.0 / one.variance for one in used)
    time = sum(one.time / one.variance for one in used) / total
    centre = ZERO
    for one in used:
        centre = combined(1.0, centre, 1.0 / one.variance / total, one.direction)
    azimuth, elevation = angles(centre)
    middle, axes = direction_of(azimuth, elevation), tangents(azimuth, elevation)
    information, vector = np.zeros((2, 2)), np.zeros(2)
    for one in used:
        row = np.array([dot(one.normal, axis) for axis in axes])
        begin = dot(one.normal, combined(1.0, one.direction, -1.0, middle))
        information += np.outer(row, row) / one.variance
        vector += row * ((one.value + begin + (time - one.time) * dot(one.normal, rate)) / one.variance)
    arc = np.linalg.solve(information + LEAST_INFORMATION * np.eye(2), vector)
    length = min(float(np.linalg.norm(arc)), 0.5 * math.pi)
    across, up = (arc * np.sinc(length / math.pi)).tolist()
    ahead = combined(across, axes[0], up, axes[1])
    azimuth, elevation = angles(combined(math.cos(length), middle, 1.0, ahead))
    (hh, hv), (_, vv) = information.tolist()
    return Increment(time, seen, azimuth, elevation, hh, hv, vv)
