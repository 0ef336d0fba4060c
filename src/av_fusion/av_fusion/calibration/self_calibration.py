"""Parameters of a set-up that are learnt while it runs.

Recursive least squares with exponential forgetting (Ljung, System Identification, 1999, eq. 11.12). The prior is the set-up as
described; forgetting returns to this prior (stabilised forgetting, Kulhavy and Zarrop 1993), so that parameters that are not
excited keep their prior value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

SIGHT_CORRELATION_S = 5.0  # errors of the camera's calibration persist; comparisons within this time are not independent
LEAST_CONFIDENCE = 0.5  # of detections and of directions of arrival that are compared
BOUND = 2.0  # largest correction, in standard deviations of the prior
GATE = 4.0  # largest innovation of a comparison that is used, in standard deviations
MEMORY_S = 60.0  # time constant of forgetting


class SelfCalibration:
    """Recursive estimate of what differs from the description.

    Attributes:
        compared: number of comparisons used so far.
        values (n,): the parameters, in the order of their names.

    Parameters:
        names: of the parameters.
        sigmas (n,): standard deviations of their prior.
        units: for each a factor to the unit of texts, and its name.
    """

    def __init__(self, names: Sequence[str], sigmas: NDArray[np.float64], units: Sequence[tuple[float, str]]) -> None:
        self._names, self._usual, self._units = names, sigmas, units
        self._bounds = BOUND * sigmas
        self._prior = np.diag(1.0 / sigmas**2)  # information matrix
        self._gained = np.zeros_like(self._prior)  # information beyond the prior
        self._covariance = np.linalg.inv(self._prior)
        self._vector = np.zeros(len(names))
        self._time = -math.inf
        self.values = [0.0] * len(names)
        self.compared = 0

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Standard deviations of the parameters (n,)."""
        return np.sqrt(np.diag(self._covariance))

    @property
    def at_limit(self) -> list[str]:
        """Names of the parameters that are learnt, and would be corrected by more than is permitted."""
        stands = (self.sigmas < 0.5 * self._usual) & (np.abs(self.values) >= self._bounds)
        return [name for name, at in zip(self._names, stands, strict=True) if at]

    def learn(self, time: float, slopes: ArrayLike, residuals: ArrayLike, variances: ArrayLike, lasting: ArrayLike) -> bool:
        """Update the parameters by a comparison of k quantities; returns whether any of them was used.

        Parameters:
            time (s): of the comparison.
            slopes (k, n): derivatives of the quantities by the parameters.
            residuals (k,): measured minus expected by the description.
            variances (k,): of the errors; to be enlarged when those of successive calls are correlated.
            lasting (k,): variances of the errors that persist for SIGHT_CORRELATION_S.
        """
        rows, left = np.array(slopes), np.array(residuals)
        if time < self._time - SIGHT_CORRELATION_S:  # the clock was set back: nothing was compared on the new one yet
            self._time = -math.inf
        seconds = min(max(time - self._time, 0.01), SIGHT_CORRELATION_S)
        spread = np.array(variances) + np.array(lasting) * (SIGHT_CORRELATION_S / seconds)
        total = np.add.reduce(rows.dot(self._covariance) * rows, axis=1) + spread
        used = (left - rows.dot(self.values)) ** 2 <= GATE**2 * total
        if not np.logical_or.reduce(used):
            return False
        kept = math.exp(-min(max(time - self._time, 0.0), 1.0) / MEMORY_S)
        self._time = max(self._time, time)
        weighed = rows[used] / spread[used, None]
        self._gained = kept * self._gained + rows[used].T.dot(weighed)
        self._vector = kept * self._vector + left[used].dot(weighed)
        self._covariance = np.linalg.inv(self._prior + self._gained)
        self.values = np.minimum(np.maximum(self._covariance.dot(self._vector), -self._bounds), self._bounds).tolist()
        self.compared += 1
        return True

    def describe(self) -> dict[str, str]:
        """The parameters with their standard deviations, as texts for diagnostics."""
        return {name: f'{scale * value:+.2f} +- {scale * sigma:.2f} {unit}'
                for name, value, sigma, (scale, unit) in zip(self._names, self.values, self.sigmas, self._units, strict=True)}
