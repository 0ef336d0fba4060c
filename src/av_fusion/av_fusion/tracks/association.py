"""Marginal probabilities of which target each measurement of one scan stems from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ITERATIONS, TOLERANCE = 50, 1e-4


class Association(NamedTuple):
    """Which target each measurement of a scan stems from.

    Parameters:
        free (t, m): how far each measurement is free for each target: the messages of belief propagation to the targets.
        shares (t, m): marginal probabilities that measurements stem from targets.
        unclaimed (m,): marginal probabilities that they stem from none of these.
    """

    free: NDArray[np.float64]
    shares: NDArray[np.float64]
    unclaimed: NDArray[np.float64]


def associate(ratios: NDArray[np.float64], others: NDArray[np.float64]) -> Association:
    """Marginal association probabilities by belief propagation.

    A target stems at most one measurement of a scan, and a measurement from at most one target. Given the free factors v, the
    marginal probability that target t has measurement j is proportional to ratios[t, j] v[t, j], and that it has none to 1.

    Williams and Lau, Approximate evaluation of marginal association probabilities with belief propagation, IEEE Transactions on
    Aerospace and Electronic Systems 50(4), 2014, algorithm 1; it converges for every input.

    Parameters:
        ratios (t, m): likelihood that a target has a measurement, over that it has none; with the measurement's likelihood
            relative to clutter.
        others (m,): likelihood, relative to clutter, that a measurement stems from none of the targets; at least 1.
    """
    free = np.zeros(ratios.shape) + 1.0 / others
    for _ in range(ITERATIONS):
        claims = _claims(ratios, ratios * free)
        previous, free = free, 1.0 / (others + np.add.reduce(claims) - claims)
        if (abs(free - previous) <= TOLERANCE * free).all():
            break
    claimed = ratios * free
    return Association(free, claimed / (1.0 + np.add.reduce(claimed, axis=1, keepdims=True)),
                       np.asarray(others / (others + np.add.reduce(_claims(ratios, claimed)))))


def _claims(ratios: NDArray[np.float64], claimed: NDArray[np.float64]) -> NDArray[np.float64]:
    """The messages (t, m) from targets to measurements."""
    return np.asarray(ratios / (1.0 + np.add.reduce(claimed, axis=1, keepdims=True) - claimed))
