"""Pairs of microphones, and those among them that measure the same delays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from av_common.microphone_array import MicrophoneArray

SAME_M = 1e-6  # to which array files state positions


class Baselines:
    """The distinct baselines of an array: parallel pairs of one length have one delay for each direction.

    What gives a direction is linear in the cross-spectra, so that those of such pairs are added first: a ring of eight has 16
    baselines for its 28 pairs, a square 4 for its 6.

    Parameters:
        array: positions of the microphones.

    Attributes:
        pairs (p, 2): microphones of all pairs, those of one baseline one after the other.
        vectors (u, 3) (m): the baselines, r_i - r_j of their pairs.
        counts (u,): their numbers of pairs.
    """

    def __init__(self, array: MicrophoneArray) -> None:
        places = np.round(array.baselines / SAME_M)
        leading = np.take_along_axis(places, np.argmax(places != 0.0, axis=1)[:, None], axis=1)
        group = np.unique(np.sign(leading) * places, axis=0, return_inverse=True)[1].ravel()
        order = np.argsort(group, kind='stable')
        self._starts = np.flatnonzero(np.diff(group[order], prepend=-1))
        first = order[self._starts]
        opposite = np.sign(leading) != np.sign(leading[first][group])  # to the first pair of their baseline
        self.pairs: NDArray = np.where(opposite, array.pairs[:, ::-1], array.pairs)[order]
        self.vectors: NDArray = array.baselines[first]
        self.counts: NDArray = np.diff(self._starts, append=len(order))

    def sum(self, values: NDArray) -> NDArray:
        """Sums (u, ...) of values (p, ...) of the pairs of each baseline."""
        return np.asarray(np.add.reduceat(values, self._starts, axis=0))
