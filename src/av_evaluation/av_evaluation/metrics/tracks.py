"""Tracks of several targets compared with the truth: GOSPA with its parts, and identity switches."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment


class Gospa(NamedTuple):
    """GOSPA distance of one instant.

    Parameters:
        distance: the distance itself.
        localisation, missed, false: its parts, of which distance^order is the sum.
        assigned: pairs of (index of truth, index of estimate).
    """

    distance: float
    localisation: float
    missed: float
    false: float
    assigned: tuple[tuple[int, int], ...]


def gospa(distances: NDArray[np.float64], cutoff: float) -> Gospa:
    """GOSPA with p = 2 and alpha = 2: a missed and a false target each cost cutoff^2 / 2.

    Rahmathullah, Garcia-Fernandez, Svensson, Generalized optimal sub-pattern assignment metric, FUSION 2017, eq. 1 and
    proposition 1.

    Parameters:
        distances (n, m): between n true and m reported targets.
        cutoff: distance from which a pair counts as one missed and one false target.
    """
    costs = np.minimum(distances, cutoff) ** 2
    rows, columns = linear_sum_assignment(costs)
    pairs = [(int(row), int(column)) for row, column in zip(rows, columns, strict=True) if distances[row, column] < cutoff]
    localisation = float(sum(costs[pair] for pair in pairs))
    missed, false = (0.5 * cutoff**2 * (size - len(pairs)) for size in distances.shape)
    return Gospa((localisation + missed + false) ** 0.5, localisation, missed, false, tuple(pairs))


def angles_between(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (n, m, rad) between two lists of unit vectors.

    Parameters:
        first (n, 3), second (m, 3): the vectors.
    """
    return np.asarray(np.arccos(np.clip(first.reshape(-1, 3) @ second.reshape(-1, 3).T, -1.0, 1.0)))


class IdentitySwitches:
    """Counts identity switches as CLEAR MOT does: a correspondence is kept as long as it is valid.

    Bernardin and Stiefelhagen, Evaluating multiple object tracking performance: the CLEAR MOT metrics, EURASIP Journal on
    Image and Video Processing, 2008, section 2.1.3.

    Attributes:
        count: switches so far.

    Parameters:
        cutoff: distance up to which a track can correspond to a target.
    """

    def __init__(self, cutoff: float) -> None:
        self.count = 0
        self._cutoff = cutoff
        self._names: dict[int, Hashable] = {}  # of the track that last followed each target
        self._first: dict[int, Hashable] = {}  # and of that which followed it first

    @property
    def kept(self) -> float:
        """Share of the targets whose newest track has the name of their first; NaN without any."""
        same = [self._names[target] == name for target, name in self._first.items()]
        return sum(same) / len(same) if same else float('nan')

    def add(self, distances: NDArray[np.float64], names: Sequence[Hashable]) -> None:
        """Add one instant.

        Parameters:
            distances (n, m): between n true targets, in a constant order, and m tracks.
            names (m): of the tracks.
        """
        kept = {target: names.index(name) for target, name in self._names.items()
                if name in names and distances[target, names.index(name)] < self._cutoff}
        targets = [target for target in range(len(distances)) if target not in kept]
        tracks = [track for track in range(len(names)) if track not in kept.values()]
        costs = np.minimum(distances[np.ix_(targets, tracks)], self._cutoff)
        for row, column in zip(*linear_sum_assignment(costs), strict=True):
            if costs[row, column] < self._cutoff:
                target, name = targets[row], names[tracks[column]]
                self.count += self._names.get(target, name) != name
                self._names[target] = name
                self._first.setdefault(target, name)


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
