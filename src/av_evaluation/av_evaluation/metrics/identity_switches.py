"""Identity switches: how often a true target is followed by a track of another name than before."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment


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
