"""Extended Kalman filter of targets in three dimensions together with the rigs' headings and clocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_network.apparent_direction import apparent_directions
from av_network.report import Sighting
from av_network.settings import NetworkSettings, RigSettings

LEAST_SIGMA = 1e-6  # of what counts as known, so that covariances stay regular
HEADING, CLOCK = 0, 1  # in the part of the state of one rig
RIG_SIZE, TARGET_SIZE = 2, 6


class Observation(NamedTuple):
    """A direction to a target, of which the covariance holds only what is new.

    Parameters:
        rig: index of the rig.
        position (3,) (m): of the rig.
        time (s): by the rig's clock.
        sighting: the direction.
        covariance (2, 2) (rad^2): of its horizontal and vertical error.
    """

    rig: int
    position: NDArray[np.float64]
    time: float
    sighting: Sighting
    covariance: NDArray[np.float64]


class Innovations(NamedTuple):
    """Differences of one observation from what each of n targets would give.

    Parameters:
        covariances (n, 2, 2) (rad^2): of the differences.
        squared (n,): Mahalanobis distances, squared.
    """

    covariances: NDArray[np.float64]
    squared: NDArray[np.float64]


class _Linearised(NamedTuple):
    """Residuals (n, 2) (rad), their derivatives (n, 2, 8) by the rig's and the target's state, noise (n, 2, 2) (rad^2)."""

    residuals: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    noise: NDArray[np.float64]


class JointFilter:
    """Targets of nearly constant velocity, seen from rigs whose headings and clocks are off by slowly varying amounts.

    The state is (heading, clock) of each rig, then (position, velocity) of each target. A heading correction is added to the
    azimuths of its rig, a clock offset to its stamps.

    Attributes:
        time (s): for which the state holds, by the reference clock; None before the first prediction.
        mean (n,), covariance (n, n): the state.

    Parameters:
        rigs: what is known of each.
        settings: see `NetworkSettings`.
    """

    def __init__(self, rigs: Sequence[RigSettings], settings: NetworkSettings) -> None:
        self._rigs, self._settings = tuple(rigs), settings
        self.time: float | None = None
        sigmas = np.array([(rig.heading_sigma, rig.clock_sigma) for rig in rigs]).reshape(-1)
        self.mean = np.zeros(len(sigmas))
        self.covariance = np.diag(np.maximum(sigmas, LEAST_SIGMA) ** 2)
        self._offset = len(sigmas)
        drifts = np.array([settings.heading_drift, settings.clock_drift]) ** 2
        self._drift = np.tile(drifts, len(self._rigs)) * (sigmas > 0.0)

    @property
    def count(self) -> int:
        """Number of targets."""
        return (len(self.mean) - self._offset) // TARGET_SIZE

    def rig_state(self, rig: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (2,) and standard deviations (2,) of heading correction (rad) and clock offset (s) of a rig."""
        part = slice(RIG_SIZE * rig, RIG_SIZE * (rig + 1))
        return self.mean[part].copy(), np.sqrt(np.diag(self.covariance)[part])

    def corrected_time(self, rig: int, time: float) -> float:
        """A rig's stamp by the reference clock (s).

        Parameters:
            rig: index of the rig.
            time (s): its stamp.
        """
        return time + float(self.mean[RIG_SIZE * rig + CLOCK])

    def target(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (6,) and covariance (6, 6) of position and velocity of a target."""
        part = self._part(index)
        return self.mean[part].copy(), self.covariance[part, part].copy()

    def conditional_covariance(self, index: int) -> NDArray[np.float64]:
        """Covariance (6, 6) of a target if headings and clocks were known."""
        return self._given_rigs(self._part(index))[1]

    def difference(self, first: int, second: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (6,) and covariance (6, 6) of the difference of two targets."""
        a, b = self._part(first), self._part(second)
        P = self.covariance
        return self.mean[a] - self.mean[b], P[a, a] + P[b, b] - P[a, b] - P[b, a]

    def branch(self) -> JointFilter:
        """A filter of the same rigs without targets."""
        other = JointFilter(self._rigs, self._settings)
        n = self._offset
        other.time, other.mean, other.covariance = self.time, self.mean[:n].copy(), self.covariance[:n, :n].copy()
        return other

    def add(self, mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Add a target that is independent of all else.

        Parameters:
            mean (6,), covariance (6, 6): of its position and velocity.
        """
        n = len(self.mean)
        grown = np.zeros((n + TARGET_SIZE, n + TARGET_SIZE))
        grown[:n, :n], grown[n:, n:] = self.covariance, covariance
        self.mean, self.covariance = np.concatenate([self.mean, mean]), grown

    def adopt(self, other: JointFilter) -> None:
        """Add the only target of a branch, with its dependence on headings and clocks, at this filter's time.

        Given headings and clocks, the target's estimate is independent of what this filter has learnt of them; that part is
        taken over, and nothing is counted twice.

        Parameters:
            other: the branch; it is moved to this filter's time.
        """
        if self.time is not None:
            other.predict(self.time)
        n = self._offset
        gain, conditional = other._given_rigs(slice(n, None))
        mean = other.mean[n:] + gain @ (self.mean[:n] - other.mean[:n])
        cross = gain @ self.covariance[:n, :]  # with all of this filter's state
        self.add(mean, conditional + cross[:, :n] @ gain.T)
        self.covariance[-TARGET_SIZE:, :-TARGET_SIZE] = cross
        self.covariance[:-TARGET_SIZE, -TARGET_SIZE:] = cross.T

    def set_rigs(self, mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Replace what is known of headings and clocks; the targets move as far as they depend on them.

        Parameters:
            mean (2 r,), covariance (2 r, 2 r): (heading, clock) of each of r rigs.
        """
        n = self._offset
        gain, conditional = self._given_rigs(slice(n, None))
        cross = gain @ covariance
        self.mean = np.concatenate([mean, self.mean[n:] + gain @ (mean - self.mean[:n])])
        self.covariance = np.block([[covariance, cross.T], [cross, conditional + cross @ gain.T]])

    def remove(self, index: int) -> None:
        """Remove a target; those after it move up."""
        part = np.arange(*self._part(index).indices(len(self.mean)))
        self.mean = np.delete(self.mean, part)
        self.covariance = np.delete(np.delete(self.covariance, part, 0), part, 1)

    def predict(self, time: float) -> None:
        """Move the state to a time (s) by the reference clock; a time before that of the state changes nothing."""
        step = 0.0 if self.time is None else time - self.time
        if self.time is not None and step <= 0.0:
            return
        self.time = time
        n = self._offset
        self.covariance[range(n), range(n)] += step * self._drift
        if not self.count:
            return
        places = (n + TARGET_SIZE * np.arange(self.count)[:, None] + np.arange(3)).reshape(-1)
        P = self.covariance
        self.mean[places] += step * self.mean[places + 3]
        P[places] += step * P[places + 3]
        P[:, places] += step * P[:, places + 3]
        density = self._settings.manoeuvre
        P[places, places] += density * step**3 / 3.0
        P[places, places + 3] += density * step**2 / 2.0
        P[places + 3, places] += density * step**2 / 2.0
        P[places + 3, places + 3] += density * step

    def innovations(self, observation: Observation) -> Innovations:
        """Differences of an observation from what each target would give."""
        every = np.arange(self.count)
        residuals, jacobians, noise = self._linearise(observation, every)
        columns = self._columns(observation.rig, every)
        blocks = self.covariance[columns[:, :, None], columns[:, None, :]]
        covariances = jacobians @ blocks @ jacobians.transpose(0, 2, 1) + noise
        squared = np.einsum('ni,ni->n', residuals, np.linalg.solve(covariances, residuals[:, :, None])[:, :, 0])
        return Innovations(covariances, squared)

    def update(self, pairs: Sequence[tuple[int, Observation]], learn: bool = False) -> float:
        """Use observations; returns the logarithm of their density (1/rad^2 each).

        Parameters:
            pairs: index of the target, and its observation.
            learn: whether headings and clocks are corrected, too; if not, they stay, and their uncertainty is considered
                (Schmidt 1966).
        """
        if not pairs:
            return 0.0
        P = self.covariance
        H, R, residual = self._stack(pairs)
        PH = P @ H.T
        S = H @ PH + R
        gain = np.linalg.solve(S, PH.T).T
        if not learn:
            gain[:self._offset] = 0.0
        self.mean = self.mean + gain @ residual
        KPH = gain @ PH.T
        P = P - KPH - KPH.T + gain @ S @ gain.T
        self.covariance = 0.5 * (P + P.T)
        squared = float(residual @ np.linalg.solve(S, residual))
        return -0.5 * (squared + len(residual) * math.log(math.tau) + float(np.linalg.slogdet(S)[1]))

    def _stack(self, pairs: Sequence[tuple[int, Observation]]
               ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Derivatives (2m, n), noise (2m, 2m) and residuals (2m,) of m observations."""
        size = 2 * len(pairs)
        H, R, residual = np.zeros((size, len(self.mean))), np.zeros((size, size)), np.zeros(size)
        for row, (target, observation) in enumerate(pairs):
            part, index = slice(2 * row, 2 * row + 2), np.array([target])
            each = self._linearise(observation, index)
            H[part, self._columns(observation.rig, index)[0]] = each.jacobians[0]
            R[part, part], residual[part] = each.noise[0], each.residuals[0]
        return H, R, residual

    def _linearise(self, observation: Observation, indices: NDArray[np.intp]) -> _Linearised:
        rig, sighting = observation.rig, observation.sighting
        targets = self.mean[self._offset:].reshape(-1, TARGET_SIZE)[indices]
        heading, clock = self.mean[RIG_SIZE * rig:RIG_SIZE * (rig + 1)]
        ahead = np.full(len(targets), observation.time + clock - (self.time or 0.0))
        speed = np.full(len(targets), self._settings.sound_speed if sighting.by_sound else math.inf)
        expected = apparent_directions(targets[:, :3], targets[:, 3:], observation.position, ahead, speed)
        level = np.cos(expected.elevation)
        residuals = np.stack([wrap(sighting.azimuth + heading - expected.azimuth) * level,
                              sighting.elevation - expected.elevation], 1)
        jacobians = np.concatenate([np.stack([-level, 0.0 * level], 1)[:, :, None], expected.by_time[:, :, None],
                                    expected.by_position, expected.by_velocity], 2)
        place = ((self._rigs[rig].position_sigma / expected.distance) ** 2)[:, None, None] * np.eye(2)
        return _Linearised(residuals, jacobians, observation.covariance + place)

    def _given_rigs(self, part: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Dependence (k, n) of a part of the state on headings and clocks, and its covariance (k, k) if those were known."""
        n, P = self._offset, self.covariance
        gain = np.linalg.solve(P[:n, :n], P[:n, part]).T
        return gain, P[part, part] - gain @ P[:n, part]

    def _part(self, index: int) -> slice:
        start = self._offset + TARGET_SIZE * index
        return slice(start, start + TARGET_SIZE)

    def _columns(self, rig: int, indices: NDArray[np.intp]) -> NDArray[np.intp]:
        """Indices (k, 8) of a rig's part of the state and of those of k targets."""
        own = np.tile(np.arange(RIG_SIZE * rig, RIG_SIZE * (rig + 1)), (len(indices), 1))
        return np.concatenate([own, self._offset + TARGET_SIZE * indices[:, None] + np.arange(TARGET_SIZE)], 1)
