"""The posterior of the targets' azimuth in the body frame, in equal sectors."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.tracks.track import MAX_GAP_S, Track

SECTORS = 120  # of 3 deg: finer than a picture shows
EDGES = np.linspace(-math.pi, math.pi, SECTORS + 1)
TURNS = math.tau * np.arange(-2, 3)[:, None]  # beyond which a normal distribution has nothing at deviations up to pi
_ERF = np.frompyfunc(math.erf, 1, 1)  # the import of scipy.special takes a quarter of a node's start


def azimuth_posterior(tracks: Iterable[Track], motion: RigMotion, time: float) -> NDArray[np.float64]:
    """Expected number of targets in each of SECTORS sectors from -pi on, at a time after the newest measurement.

    Each component is a wrapped normal distribution of the azimuth; what does not exist is nowhere.

    Parameters:
        tracks: all that are tracked.
        motion: attitude and path of the rig.
        time (s): the time.
    """
    total, attitude = np.zeros(SECTORS), motion.attitude(time)
    for track in (track for track in tracks if time - track.time < MAX_GAP_S):
        for component in track.later(time).values():
            found = component.in_body(attitude)
            total += component.weight * _wrapped_normal(found.azimuth, found.azimuth_variance)
    return total


def _wrapped_normal(azimuth: float, variance: float) -> NDArray[np.float64]:
    """Probability of each sector."""
    inside = np.diff(np.asarray(_ERF((EDGES + TURNS - azimuth) / math.sqrt(2.0 * variance)), float), axis=1).sum(axis=0)
    return inside / inside.sum()
