"""Where directions of different rigs meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import angles_to_direction
from av_network.observation import Observation

MOST_APART = 9.0  # squared distance of two directions where they are closest, over its variance
LEAST_SINE_SQUARED = 1e-3  # of the angle between two directions


class Meetings(NamedTuple):
    """Where one direction meets k others.

    Parameters:
        places (k, 3) (m): between both where they are closest, nearer to the more precise one.
        apart (k,): squared distance there over its variance; inf where they do not meet ahead of both rigs and within range.
    """

    places: NDArray[np.float64]
    apart: NDArray[np.float64]


def meetings(one: Observation, others: Sequence[Observation], headings: NDArray[np.float64],
             heading_variances: NDArray[np.float64], most_distance: float, slack: float) -> Meetings:
    """Where a reported direction meets those of other rigs.

    Parameters:
        one: the direction.
        others (k,): of other rigs.
        headings (r,) (rad), heading_variances (r,) (rad^2): corrections of the rigs' headings.
        most_distance (m): of a place from either rig.
        slack (m): standard deviation of how far a target moves between the times of the directions.
    """
    every = [one, *others]
    rigs = np.array([each.rig for each in every])
    azimuths = np.array([each.sighting.azimuth for each in every]) + headings[rigs]
    units = angles_to_direction(azimuths, np.array([each.sighting.elevation for each in every]))
    origins = np.array([each.position for each in every])
    variances = np.array([np.trace(each.sighting.covariance) for each in every]) / 2.0 + heading_variances[rigs]
    a, b, offsets = units[0], units[1:], origins[1:] - origins[0]
    cosine, along = b @ a, offsets @ a
    across = np.einsum('ki,ki->k', offsets, b)
    sine = np.maximum(1.0 - cosine**2, LEAST_SINE_SQUARED)
    near, far = (along - cosine * across) / sine, (cosine * along - across) / sine
    spreads = np.minimum(variances[0], 1.0) * near**2, np.minimum(variances[1:], 1.0) * far**2
    ends = origins[0] + near[:, None] * a, origins[1:] + far[:, None] * b
    total = spreads[0] + spreads[1]
    places = (spreads[1][:, None] * ends[0] + spreads[0][:, None] * ends[1]) / np.maximum(total, 1e-12)[:, None]
    apart = np.sum((ends[0] - ends[1]) ** 2, axis=1) / (total + slack**2)
    possible = (1.0 - cosine**2 > LEAST_SINE_SQUARED) & (np.minimum(near, far) > 0.0) & (np.maximum(near, far) < most_distance)
    return Meetings(places, np.where(possible, apart, np.inf))
