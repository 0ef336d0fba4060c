"""Tracks of several targets compared with the truth: GOSPA with its parts, and identity switches."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_evaluation.metrics.gospa import angles_between, gospa
from av_evaluation.metrics.identity_switches import IdentitySwitches

CUTOFF_DEG = 15.0  # an error from which a target counts as missed and a track as false


class TrackFigures(NamedTuple):
    """Figures of all tracks of a run.

    Parameters:
        gospa_deg: mean GOSPA distance over time (deg).
        localisation_deg, missed, false: mean of its parts: root mean square error of the assigned (deg), and numbers of
            missed and false targets.
        switches: identity switches.
        kept: share of the targets that are followed at last under the name that they were given first; NaN where none was.
    """

    gospa_deg: float
    localisation_deg: float
    missed: float
    false: float
    switches: int
    kept: float


class TrackComparison:
    """Compares the tracks of one instant after the other."""

    def __init__(self) -> None:
        self._identities = IdentitySwitches(CUTOFF_DEG)
        self._distances: list[tuple[float, float, float, float]] = []
        self._assigned = 0

    def add(self, truth: NDArray[np.float64], tracks: Mapping[int, NDArray[np.float64]]) -> None:
        """Add an instant.

        Parameters:
            truth (n, 3): unit vectors to the targets, always in the same order.
            tracks (3,): unit vectors to the tracked ones by their ids.
        """
        distances = np.degrees(angles_between(truth, np.array(list(tracks.values()))))
        self._identities.add(distances, list(tracks))
        each = gospa(distances, CUTOFF_DEG)
        self._assigned += len(each.assigned)
        self._distances.append(each[:4])

    def figures(self) -> TrackFigures:
        """Figures of the instants so far, NaN before the first."""
        if not self._distances:
            return TrackFigures(math.nan, math.nan, math.nan, math.nan, 0, math.nan)
        distance, localisation, missed, false = np.mean(np.array(self._distances), axis=0).tolist()
        unit = 0.5 * CUTOFF_DEG**2
        error = math.sqrt(localisation * len(self._distances) / max(self._assigned, 1))
        return TrackFigures(distance, error, missed / unit, false / unit, self._identities.count, self._identities.kept)
