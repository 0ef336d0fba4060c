"""Marginal probabilities of which target each measurement of one scan stems from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ITERATIONS, TOLERANCE = 50, 1e-4


def free_factors(ratios: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each measurement is free for each target: the messages from measurements to targets of belief propagation.

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
        claimed = ratios * free
        claims = ratios / (1.0 + np.add.reduce(claimed, axis=1, keepdims=True) - claimed)
        previous, free = free, 1.0 / (others + np.add.reduce(claims) - claims)
        if (abs(free - previous) <= TOLERANCE * free).all():
            break
    return free


def association_probabilities(ratios: NDArray[np.float64], free: NDArray[np.float64]) -> NDArray[np.float64]:
    """Marginal probabilities (t, m) that measurements stem from targets; see `free_factors` for the arguments."""
    claimed = ratios * free
    return claimed / (1.0 + np.add.reduce(claimed, axis=1, keepdims=True))


def unclaimed(ratios: NDArray[np.float64], free: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Marginal probabilities (m,) that measurements stem from none of the targets.

    Parameters:
        ratios (t, m), others (m,): see `free_factors`.
        free (t, m): the free factors.
    """
    claimed = ratios * free
    claims = ratios / (1.0 + np.add.reduce(claimed, axis=1, keepdims=True) - claimed)
    return np.asarray(others / (others + np.add.reduce(claims)))
