"""Independent measurements that are equivalent to the reports of a rig's filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network import sphere
from av_network.motion_model import nearly_constant_velocity
from av_network.report import Report, Sighting

FORGOTTEN_S = 10.0
LARGEST_VARIANCE = 10.0  # rad^2, of an elevation that is not measured
LEAST_GAIN = 0.02  # of a report, below which it is taken for a prediction
EXCESS_MEMORY = 4.0  # reports over which the consistency of a rig's filter is averaged
MOST_EXCESS = 36.0
JUMP = 36.0  # squared Mahalanobis distance of a report from the one before, from which the rig has begun anew


class Tracklet(NamedTuple):
    """An equivalent measurement: see `Observation`, whose fields of the same names these are."""

    sighting: Sighting
    angles: NDArray[np.float64]
    covariance: NDArray[np.float64]
    anew: bool


@dataclass
class _Replica:
    """The rig's filter of one track as far as its reports tell.

    Parameters:
        time, measured (s): of its newest report, and of the newest measurement therein.
        angles (2,) (rad): azimuth and elevation.
        rates (3,) (rad/s): of the direction, a vector in the world.
        covariance (2, 2, 2): of the arc and its rate, across and up.
        excess: running mean of the normalised innovation squared of each axis, 1 being expected.
    """

    time: float
    measured: float
    angles: NDArray[np.float64]
    rates: NDArray[np.float64]
    covariance: NDArray[np.float64]
    excess: float = 1.0


class Tracklets:
    """Undoes the filters of rigs (the inverse Kalman filter of Drummond 1997).

    The errors of a filter's reports are correlated, and lag behind manoeuvres. A replica of the rig's filter, which has
    the same nearly constant angular velocity, predicts the angle and its variance P. The reported variance V then tells the
    gain K = 1 - V / P, the variance R = V / K and the innovation of the measurement that the rig has used since its last
    report. Such measurements have independent errors and no lag. A first report is taken as a measurement; one without a new
    measurement says nothing.

    Where a rig's filter does not follow, as when a target passes close by, its own innovations tell: the square of K nu is K P
    on average. As far as the mean of their ratio exceeds 1, the variance R is greater.

    Parameters:
        density (rad^2/s^3): of the angular acceleration in the rigs' filters.
        rate_sigma (rad/s): prior standard deviation of the rates there.
    """

    def __init__(self, density: float, rate_sigma: float) -> None:
        self._density, self._rate_sigma = density, rate_sigma
        self._replicas: dict[tuple[str, int], _Replica] = {}

    def fresh(self, report: Report) -> list[Tracklet]:
        """The sightings that say something new.

        Parameters:
            report: of a rig, in the order of capture.
        """
        found = [self._tracklet(report, sighting) for sighting in report.sightings]
        self._replicas = {key: each for key, each in self._replicas.items() if abs(report.time - each.time) <= FORGOTTEN_S}
        return [each for each in found if each is not None]

    def _tracklet(self, report: Report, sighting: Sighting) -> Tracklet | None:
        key, covariance = (report.rig, sighting.id), bounded(sighting.covariance)
        angles, variances = np.array([sighting.azimuth, sighting.elevation]), np.diag(covariance)
        replica = self._replicas.get(key)
        if replica is None:
            return self._begin(key, report.time, sighting, angles, covariance)
        step = report.time - replica.time
        if sighting.measured <= replica.measured or step <= 0.0:
            return None
        F, Q = nearly_constant_velocity(step, self._density)
        P = F @ replica.covariance @ F.T + Q
        ahead = sphere.moved(replica.angles, step * replica.rates)
        moved = sphere.offsets(angles, ahead)
        gain = 1.0 - variances / P[:, 0, 0]
        if np.any(moved**2 > JUMP * (P[:, 0, 0] + variances)):
            return self._begin(key, report.time, sighting, angles, covariance)
        known = np.maximum(gain, LEAST_GAIN)
        ratio = P[:, 1, 0] / P[:, 0, 0]
        # Where the variance has grown, the rig's filter knows less than the replica, which is scaled.
        P = P * np.maximum(variances / P[:, 0, 0] / (1.0 - LEAST_GAIN), 1.0)[:, None, None]
        excess = float(np.mean(np.minimum(moved**2 / (known * P[:, 0, 0]), MOST_EXCESS)))
        excess = replica.excess + (excess - replica.excess) / EXCESS_MEMORY
        rates = sphere.carried(replica.rates, replica.angles, ahead) + sphere.vectors(ratio * moved, ahead)
        self._replicas[key] = _Replica(
            report.time, sighting.measured, angles, sphere.carried(rates, ahead, angles),
            P - known[:, None, None] * P[:, :, :1] * P[:, :1, :] / P[:, :1, :1], excess)
        if np.all(gain < LEAST_GAIN):
            return None
        scale = np.sqrt(max(excess, 1.0) / known)
        equivalent = sphere.moved(ahead, sphere.vectors(moved / known, ahead))
        return Tracklet(sighting, equivalent, covariance * np.outer(scale, scale), False)

    def _begin(self, key: tuple[str, int], time: float, sighting: Sighting, angles: NDArray[np.float64],
               covariance: NDArray[np.float64]) -> Tracklet:
        P = np.array([np.diag([variance, self._rate_sigma**2]) for variance in np.diag(covariance)])
        self._replicas[key] = _Replica(time, sighting.measured, angles, np.zeros(3), P)
        return Tracklet(sighting, angles, covariance, True)


def bounded(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """The covariance (2, 2) with variances up to LARGEST_VARIANCE; a variance that is not known has no correlation."""
    if np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) < LARGEST_VARIANCE):
        return covariance
    return np.diag(np.minimum(np.nan_to_num(np.diag(covariance), nan=LARGEST_VARIANCE), LARGEST_VARIANCE))
