"""How probable it is that two targets have been taken for each other."""

from __future__ import annotations

import math

import numpy as np

from av_fusion.measurement.vectors import dot, offset, tangents
from av_fusion.tracks.component import GaussianComponent

STATES = 4  # directions across and up, and their rates
TURNED = np.diag([0.0, 0.0, 1.0, 1.0]) * math.radians(4.0) ** 2  # (rad/s)^2, of manoeuvres unseen
NEAR = math.cos(math.radians(40.0))  # of directions that may be confused


def overlap(one: GaussianComponent, other: GaussianComponent) -> float:
    """Bhattacharyya coefficient 0..1 of two components by direction and rates: 1 where they are equal.

    Half of it bounds the probability that a target of one is taken for that of the other (Kailath, The divergence and
    Bhattacharyya distance measures in signal selection, IEEE Transactions on Communication Technology 15(1), 1967).
    """
    if dot(one.direction, other.direction) < NEAR:
        return 0.0
    across, up = offset(one.direction, *tangents(one.azimuth, one.elevation), other.direction)
    difference = np.array([across, up, other.across_rate - one.across_rate, other.up_rate - one.up_rate])
    first, second = (component.covariance[:STATES, :STATES] + TURNED for component in (one, other))
    mean = 0.5 * (first + second)
    distance = 0.125 * float(difference @ np.linalg.solve(mean, difference))
    volumes = [np.linalg.slogdet(matrix)[1] for matrix in (mean, first, second)]
    return min(math.exp(-distance - 0.5 * (volumes[0] - 0.5 * (volumes[1] + volumes[2]))), 1.0)
