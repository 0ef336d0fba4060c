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
        pairs (p, 2): microphones of all pairs: the first of each baseline, then the second of those that have one, and so on.
        vectors (u, 3) (m): the baselines, r_i - r_j of their pairs, those of most pairs first.
        counts (u,): their numbers of pairs.
    """

    def __init__(self, array: MicrophoneArray) -> None:
        groups, vectors = list[list[NDArray]](), list[NDArray]()
        for pair, vector in zip(array.pairs, array.baselines, strict=True):
            for group, other in zip(groups, vectors, strict=True):
                if min(np.abs(vector - other).max(), np.abs(vector + other).max()) < SAME_M:
                    group.append(pair if vector @ other > 0.0 else pair[::-1])
                    break
            else:
                groups.append([pair])
                vectors.append(vector)
        order = sorted(range(len(groups)), key=lambda k: -len(groups[k]))
        self.vectors: NDArray = np.array([vectors[k] for k in order])
        self.counts: NDArray = np.array([len(groups[k]) for k in order])
        self.pairs: NDArray = np.array([groups[k][n] for n in range(self.counts[0]) for k in order if n < len(groups[k])])

    def sum(self, values: NDArray) -> NDArray:
        """Sums (u, ...) of values (p, ...) of the pairs of each baseline."""
        total, begin = values[:len(self.counts)].copy(), len(self.counts)
        for number in range(1, self.counts[0]):
            more = np.count_nonzero(self.counts > number)
            total[:more] += values[begin:begin + more]
            begin += more
        return total
