"""GOSPA: distance between the set of true directions and the set of reported ones, with its three parts."""

from __future__ import annotations

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


def gospa(distances: NDArray[np.float64], cutoff: float, order: float = 2.0) -> Gospa:
    """GOSPA with alpha = 2: a missed and a false target each cost cutoff^order / 2.

    Rahmathullah, Garcia-Fernandez, Svensson, Generalized optimal sub-pattern assignment metric, FUSION 2017, eq. 1 and
    proposition 1.

    Parameters:
        distances (n, m): between n true and m reported targets.
        cutoff: distance from which a pair counts as one missed and one false target.
        order: exponent.
    """
    costs = np.minimum(distances, cutoff) ** order
    rows, columns = linear_sum_assignment(costs)
    pairs = [(int(row), int(column)) for row, column in zip(rows, columns, strict=True) if distances[row, column] < cutoff]
    localisation = float(sum(costs[pair] for pair in pairs))
    missed, false = (0.5 * cutoff**order * (size - len(pairs)) for size in distances.shape)
    return Gospa((localisation + missed + false) ** (1.0 / order), localisation, missed, false, tuple(pairs))


def angles_between(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (n, m, rad) between two lists of unit vectors.

    Parameters:
        first (n, 3), second (m, 3): the vectors.
    """
    return np.asarray(np.arccos(np.clip(first.reshape(-1, 3) @ second.reshape(-1, 3).T, -1.0, 1.0)))
