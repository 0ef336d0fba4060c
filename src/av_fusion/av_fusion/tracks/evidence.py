"""What measurements that a component has accepted say of its direction, apart from the filter's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from av_fusion.measurement.vectors import Vector, angles, tangents
from av_fusion.measurement.vectors import direction as direction_of

LONGEST_S = 0.6  # for which evidence is kept, and a direction moves uniformly: reports come twice a second at least
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
    if not evidence:
        return None
    seen = any(one.seen for one in evidence)
    used = [one for one in evidence if one.seen == seen]
    times, values, variances = np.array([(one.time, one.value, one.variance) for one in used]).T
    normals, begins = np.array([one.normal for one in used]), np.array([one.direction for one in used])
    time = float(np.average(times, weights=1.0 / variances))
    azimuth, elevation = angles(np.average(begins, axis=0, weights=1.0 / variances).tolist())
    middle, axes = np.array(direction_of(azimuth, elevation)), np.array(tangents(azimuth, elevation))
    rows = normals @ axes.T
    weighted = (rows / variances[:, None]).T
    arcs = values + np.sum(normals * (begins - middle), axis=1) + (time - times) * (normals @ np.array(rate))
    information = weighted @ rows
    (hh, hv), (_, vv) = information.tolist()
    ahead = middle + np.linalg.solve(information + LEAST_INFORMATION * np.eye(2), weighted @ arcs) @ axes
    return Increment(time, seen, *angles(ahead.tolist()), hh, hv, vv)
