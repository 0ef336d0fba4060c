"""The information in a rig's filtered direction that earlier reports of the same track do not hold."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network.report import Report, Sighting

FORGOTTEN_S = 10.0
LARGEST_VARIANCE = 10.0  # rad^2, of an elevation that is not measured


class _Used(NamedTuple):
    time: float
    measured: float


def correlation_time(variance: float, density: float) -> float:
    """Correlation time (s) of the errors of a filter that has the variance in its steady state.

    A Kalman-Bucy filter for white acceleration of density q and measurements of density r has the variance
    P = sqrt(2) q^(1/4) r^(3/4), and its error the spectral density r at the frequency 0; the time is r / (2 P).

    Parameters:
        variance (rad^2): of the filtered direction.
        density (rad^2/s^3): of the angular acceleration in the filter.
    """
    return 0.5 ** (5.0 / 3.0) * (variance / density) ** (1.0 / 3.0)


@dataclass
class Decorrelation:
    """Inflates the variances of reports so that their sum of information is that of the measurements behind them.

    The errors of a track's reports are taken as first-order Gauss-Markov. Of such a sequence the first report has the
    information 1 / P, and each further one (1 - rho) / (1 + rho) / P with rho = exp(-interval / correlation time): exact for a
    constant. Reports without a new measurement have none.

    Parameters:
        density (rad^2/s^3): see `correlation_time`.
    """

    density: float
    _used: dict[tuple[str, int], _Used] = field(default_factory=dict)

    def fresh(self, report: Report) -> list[tuple[Sighting, NDArray[np.float64]]]:
        """The sightings that say something new, each with the covariance (2, 2) (rad^2) of what is new.

        Parameters:
            report: of a rig, in the order of capture.
        """
        found = []
        for sighting in report.sightings:
            key = (report.rig, sighting.id)
            last = self._used.get(key)
            if last is not None and sighting.measured <= last.measured:
                continue
            covariance = _bounded(sighting.covariance)
            factors = np.ones(2)
            if last is not None:
                interval = report.time - last.time
                if interval <= 0.0:
                    continue
                factors = np.array([self._factor(variance, interval) for variance in np.diag(covariance)])
            self._used[key] = _Used(report.time, sighting.measured)
            scale = np.sqrt(factors)
            found.append((sighting, covariance * np.outer(scale, scale)))
        self._forget(report.time)
        return found

    def _factor(self, variance: float, interval: float) -> float:
        return 1.0 / math.tanh(0.5 * interval / correlation_time(variance, self.density))

    def _forget(self, time: float) -> None:
        for key in [key for key, used in self._used.items() if abs(time - used.time) > FORGOTTEN_S]:
            del self._used[key]


def _bounded(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """The covariance with variances up to LARGEST_VARIANCE; a variance that is not known has no correlation."""
    if np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) < LARGEST_VARIANCE):
        return covariance
    return np.diag(np.minimum(np.nan_to_num(np.diag(covariance), nan=LARGEST_VARIANCE), LARGEST_VARIANCE))
