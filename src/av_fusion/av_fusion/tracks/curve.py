"""A likelihood over the cosine that a linear array measures, as it is: with all of its peaks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.microphone_array import COSINES
from av_fusion.tracks.past_state import Deviation, PastState, Row

NODES = np.linspace(-3.5, 3.5, 129)  # standard deviations, at which a normal density stands for itself
WEIGHTS = np.exp(-0.5 * NODES**2) / np.sum(np.exp(-0.5 * NODES**2))
# Share of a variance that a measurement removes: bounds where several peaks enlarge it, and where one of them is all.
LEAST_REMOVED, MOST_REMOVED = 0.01, 0.999


class Curve(NamedTuple):
    """A likelihood multiplied with what a component predicts, in each mode of motion.

    Parameters:
        means, variances (k,): of the predicted cosine.
        likelihoods (k, n): the likelihood at the means plus NODES standard deviations.
    """

    means: NDArray[np.float64]
    variances: NDArray[np.float64]
    likelihoods: NDArray[np.float64]

    @classmethod
    def of(cls, means: NDArray[np.float64], variances: NDArray[np.float64], likelihood: NDArray[np.float64]) -> Curve:
        """The likelihood at COSINES, for predicted means and variances (k,)."""
        places = means[:, None] + np.sqrt(variances)[:, None] * NODES
        return cls(means, variances, np.interp(places, COSINES, likelihood))

    def fits(self, fraction: float) -> NDArray[np.float64]:
        """Mean likelihood (k,), raised to the effective sample fraction."""
        return np.asarray(self.likelihoods**fraction @ WEIGHTS)

    def deviation(self, past: PastState, row: Row, fraction: float) -> Deviation:
        """The measurement with Gaussian noise after which the cosine has the same moments.

        Parameters:
            past: what the component predicts.
            row: derivatives of the cosine with respect to the direction across and up.
            fraction: effective sample fraction.
        """
        posterior = WEIGHTS * self.likelihoods**fraction
        posterior /= posterior.sum(axis=1, keepdims=True)
        mean = posterior @ NODES
        removed = np.clip(1.0 - (posterior @ NODES**2 - mean**2), LEAST_REMOVED, MOST_REMOVED)
        variances = np.maximum(self.variances, past.variances(row))  # at end-fire the latter vanishes
        return Deviation(row, np.sqrt(variances) * mean / removed, variances / removed, 0.0)
