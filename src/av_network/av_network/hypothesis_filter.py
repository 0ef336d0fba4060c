"""Extended Kalman filters of all supposed targets at once, each with the rigs' headings and clocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from av_network import sphere
from av_network.apparent_direction import apparent_directions
from av_network.motion_model import axes_shares, mixed, mixing, target_motion, usual_modes
from av_network.observation import Observation
from av_network.settings import NetworkSettings, RigSettings

LEAST_SIGMA = 1e-6  # of what counts as known, so that covariances stay regular
HEADING, CLOCK = 0, 1  # in the part of the state of one rig
RIG_SIZE, MEASURED_SIZE, TARGET_SIZE = 2, 6, 9
LOG_TAU = math.log(math.tau)
LEAST_STEP_S = 0.05  # of a prediction: accelerations move a target by millimetres in less
LEAST_MODE = 1e-3  # probability of a mode, so that it can return at once
# Errors of images that rigs do not state (rad^2): their variance at first, as of a mast's tilt and a lens, its standard
# deviation, and the number of directions from which it is learned, those of five rigs in 6 s.
UNSTATED, UNSTATED_SPREAD, UNSTATED_SIGHTINGS = math.radians(0.2)**2, math.radians(0.3)**2, 120.0


class Innovations(NamedTuple):
    """Differences of m observations of one rig from what each of n targets would give, in each of f modes of flight.

    Parameters:
        residuals (n, m, f, 2) (rad): the differences.
        jacobians (n, m, f, 2, 8): their derivatives by (heading, clock) of the rig and (position, velocity) of the target.
        covariances (n, m, f, 2, 2) (rad^2): of the differences.
        modes (n, m, f): probabilities of the modes given the observation.
        squared (n, m): Mahalanobis distances, squared: the mean by these.
        log_density (n, m): logarithms of the density (1/sr) of the observations.
    """

    residuals: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    covariances: NDArray[np.float64]
    modes: NDArray[np.float64]
    squared: NDArray[np.float64]
    log_density: NDArray[np.float64]

    def pick(self, targets: NDArray[np.intp], observations: NDArray[np.intp]) -> Innovations:
        """Those of k pairs of a target and an observation, without the axis of the observations."""
        return Innovations(*(part[targets, observations] for part in self))


class HypothesisFilter:
    """Targets that fly steadily or manoeuvre, seen from rigs whose headings and clocks are off by slowly varying amounts.

    Interacting multiple models: each of f modes of flight has a Gaussian of its own.

    The state of each is (heading, clock) of each of r rigs, those with exact ones counting as one, then (position, velocity,
    acceleration) of the target: N = 2 r + 9. A heading correction is added to the azimuths of its rig, a clock offset to its
    stamps. Given headings and clocks, targets are independent of each other, so no covariance between them is kept.

    Attributes:
        time (s): for which the states hold, by the reference clock; None before the first prediction.
        rig_mean (2 r,), rig_covariance (2 r, 2 r): what is known of headings and clocks, with which targets begin.
        slots: place of each rig in these.
        unstated (rad^2): variance of the errors of images that rigs do not state, see `learn_errors`.
        mean (n, f, N), covariance (n, f, N, N): the states in each mode.
        modes (n, f): probabilities of the modes.

    Parameters:
        rigs: what is known of each.
        settings: see `NetworkSettings`.
    """

    def __init__(self, rigs: Sequence[RigSettings], settings: NetworkSettings) -> None:
        self._settings = settings
        self._position_sigmas: list[float] = []
        self.slots: list[int] = []
        self.unstated, self._unstated_information = UNSTATED, 2.0 / UNSTATED_SPREAD**2
        self.time: float | None = None
        self._offset, flights = 0, len(settings.modes)
        self.rig_mean, self.rig_covariance, self._drift = np.zeros(0), np.zeros((0, 0)), np.zeros(0)
        self.mean, self.covariance = np.zeros((0, flights, TARGET_SIZE)), np.zeros((0, flights, TARGET_SIZE, TARGET_SIZE))
        self.modes = np.zeros((0, flights))
        self._exact: int | None = None
        for rig in rigs:
            self.join(rig)

    def join(self, rig: RigSettings) -> int:
        """Take part in what follows; returns the rig's slot. Rigs with an exact heading and clock share one."""
        self._position_sigmas.append(rig.position_sigma)
        exact, n, new = not (rig.heading_sigma or rig.clock_sigma), self._offset, slice(self._offset, self._offset + RIG_SIZE)
        if exact and self._exact is not None:
            self.slots.append(self._exact)
            return self._exact
        self.slots.append(n // RIG_SIZE)
        self._exact = self.slots[-1] if exact else self._exact
        added, drift = prior_of(rig, self._settings)
        self.rig_mean = np.append(self.rig_mean, np.zeros(RIG_SIZE))
        self.rig_covariance = block_diag(self.rig_covariance, added)
        self._drift = np.append(self._drift, drift)
        self.mean = np.insert(self.mean, [n] * RIG_SIZE, 0.0, axis=2)
        self.covariance = np.insert(np.insert(self.covariance, [n] * RIG_SIZE, 0.0, axis=2), [n] * RIG_SIZE, 0.0, axis=3)
        self.covariance[..., new, new] = added
        self._offset += RIG_SIZE
        return self.slots[-1]

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self.mean)

    def rig_state(self, rig: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (2,) and standard deviations (2,) of heading correction (rad) and clock offset (s) of a rig."""
        part = slice(RIG_SIZE * self.slots[rig], RIG_SIZE * (self.slots[rig] + 1))
        return self.rig_mean[part].copy(), np.sqrt(np.diag(self.rig_covariance)[part])

    @property
    def is_calibrated(self) -> bool:
        """Whether all headings and clocks are exact."""
        return set(self.slots) <= {self._exact}

    def corrected_time(self, rig: int, time: float) -> float:
        """A rig's stamp by the reference clock (s).

        Parameters:
            rig: index of the rig.
            time (s): its stamp.
        """
        return time + float(self.rig_mean[RIG_SIZE * self.slots[rig] + CLOCK])

    def targets(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Means (n, 9) and covariances (n, 9, 9) of position, velocity and acceleration."""
        n = self._offset
        return _moments(self.modes, self.mean[:, :, n:], self.covariance[:, :, n:, n:])

    def predicted(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Means (n, 9) and covariances (n, 9, 9) of the targets at a time (s); the filter itself is not moved."""
        n, step = self._offset, 0.0 if self.time is None else time - self.time
        F, Q = target_motion(step, self.mean[:, :, n + 3:n + MEASURED_SIZE], self._settings)
        return _moments(self.modes, np.einsum('nfij,nfj->nfi', F, self.mean[:, :, n:]),
                        F @ self.covariance[:, :, n:, n:] @ F.transpose(0, 1, 3, 2) + Q)

    def conditional_covariances(self, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """Covariances (k, 9, 9) of some targets (k,) if headings and clocks were known."""
        return self._given_rigs(_moments(self.modes[rows], self.mean[rows], self.covariance[rows])[1])[1]

    def difference(self, first: int, second: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (9,) and covariance (9, 9) of the difference of two targets."""
        n, pair = self._offset, np.array([first, second])
        means, (P, Q) = _moments(self.modes[pair], self.mean[pair], self.covariance[pair])
        shared = P[n:, :n] @ np.linalg.solve(P[:n, :n], Q[:n, n:])
        return means[0, n:] - means[1, n:], P[n:, n:] + Q[n:, n:] - shared - shared.T

    def add(self, means: NDArray[np.float64], covariances: NDArray[np.float64]) -> None:
        """Add targets that are independent of all else.

        Parameters:
            means (k, 6), covariances (k, 6, 6): of position and velocity.
        """
        k, n, (_, f, size) = len(means), self._offset, self.mean.shape
        mean, P = np.zeros((k, f, size)), np.zeros((k, f, size, size))
        known = slice(n, n + MEASURED_SIZE)
        mean[:, :, :n], mean[:, :, known] = self.rig_mean, means[:, None]
        P[:, :, :n, :n], P[:, :, known, known] = self.rig_covariance, covariances[:, None]
        for index, mode in enumerate(self._settings.modes):
            P[:, index, known.stop:, known.stop:] = mode.sigma**2 * np.diag(axes_shares(self._settings))
        self.mean, self.covariance = np.concatenate([self.mean, mean]), np.concatenate([self.covariance, P])
        self.modes = np.concatenate([self.modes, np.tile(usual_modes(self._settings), (k, 1))])

    def keep(self, indices: Sequence[int]) -> None:
        """Keep some targets, in the order in which they are."""
        if len(indices) == self.count:
            return
        chosen = np.array(indices, int)
        self.mean, self.covariance, self.modes = self.mean[chosen], self.covariance[chosen], self.modes[chosen]

    def set_rigs(self, mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Replace what is known of headings and clocks; the targets move as far as they depend on them.

        Parameters:
            mean (2 r,), covariance (2 r, 2 r): (heading, clock) of each of r rigs.
        """
        n = self._offset
        gain, conditional = self._given_rigs(self.covariance)
        cross = gain @ covariance
        self.mean[..., n:] += np.einsum('nfij,nfj->nfi', gain, mean - self.mean[..., :n])
        self.mean[..., :n] = mean
        P = self.covariance
        P[..., :n, :n], P[..., n:, :n], P[..., :n, n:] = covariance, cross, cross.swapaxes(-1, -2)
        P[..., n:, n:] = conditional + cross @ gain.swapaxes(-1, -2)
        self.rig_mean, self.rig_covariance = mean.copy(), covariance.copy()

    def predict(self, time: float) -> None:
        """Move all states to a time (s) by the reference clock; one before theirs, or hardly later, changes nothing."""
        step = 0.0 if self.time is None else time - self.time
        if self.time is not None and step < LEAST_STEP_S:
            return
        self.time = time
        n = self._offset
        self.modes, shares = mixing(self.modes, np.full(self.count, step), self._settings)
        self.mean, P = mixed(shares, self.mean, self.covariance)
        self.covariance = P
        self.rig_covariance[range(n), range(n)] += step * self._drift
        P[..., range(n), range(n)] += step * self._drift
        F, Q = target_motion(step, self.mean[:, :, n + 3:n + MEASURED_SIZE], self._settings)
        self.mean[..., n:] = np.einsum('nfij,nfj->nfi', F, self.mean[..., n:])
        P[..., n:, :] = F @ P[..., n:, :]
        P[..., :, n:] = P[..., :, n:] @ F.swapaxes(-1, -2)
        P[..., n:, n:] += Q

    def innovations(self, observations: Sequence[Observation], rows: NDArray[np.intp] | None = None) -> Innovations:
        """Differences of a rig's observations from what the targets would give.

        Parameters:
            observations (m,): one at least, of one report.
            rows (n,): the targets; by default all.
        """
        first, n = observations[0], self._offset
        columns, rows = self._columns(first.rig), np.arange(self.count) if rows is None else rows
        count, flights, m = len(rows), len(self._settings.modes), len(observations)
        mean = self.mean[rows].reshape(count * flights, n + TARGET_SIZE)
        heading, clock = mean[:, columns[HEADING]], mean[:, columns[CLOCK]]
        angles, noise = np.array([one.angles for one in observations]), np.array([one.covariance for one in observations])
        size = len(mean)
        P = self.covariance[rows[:, None, None], :, columns[:, None], columns]  # (n, 8, 8, f)
        P = np.moveaxis(P, 3, 1).reshape(size, 8, 8)
        residuals, jacobians, S = np.empty((size, m, 2)), np.empty((size, m, 2, 8)), np.empty((size, m, 2, 2))
        alike: dict[tuple[bool, float], list[int]] = {}
        for index, one in enumerate(observations):
            alike.setdefault((one.sighting.by_sound, one.time), []).append(index)
        for (by_sound, time), chosen in alike.items():
            ahead = time + clock - (self.time or 0.0)
            speed = np.full(size, self._settings.sound_speed if by_sound else math.inf)
            expected = apparent_directions(mean[:, n:n + 3], mean[:, n + 3:n + MEASURED_SIZE], first.position, ahead, speed)
            level = np.cos(expected.elevation)
            measured = angles[chosen] + np.stack([heading, 0.0 * heading], 1)[:, None]
            residuals[:, chosen] = sphere.offsets(measured, np.stack([expected.azimuth, expected.elevation], 1)[:, None])
            by_heading = np.stack([-level, 0.0 * level], 1)[:, :, None]
            H = np.concatenate([by_heading, expected.by_time[:, :, None], expected.by_position, expected.by_velocity], 2)
            place = (self._position_sigmas[first.rig] / expected.distance[:, None, None]) ** 2 * np.eye(2)
            jacobians[:, chosen] = H[:, None]
            S[:, chosen] = (H @ P @ H.swapaxes(1, 2) + place)[:, None] + noise[chosen]

        def apart(part: NDArray[np.float64]) -> NDArray[np.float64]:
            return part.reshape(count, flights, *part.shape[1:]).swapaxes(1, 2)

        return _weighed(apart(residuals), apart(jacobians), apart(S), self.modes[rows])

    def update(self, rig: int, rows: NDArray[np.intp], used: Innovations, learn: NDArray[np.bool_]) -> None:
        """Use one observation for each of k targets.

        Parameters:
            rig: index of the rig.
            rows (k,): the targets.
            used: of each, see `Innovations.pick`.
            learn (k,): whether the target's clocks are corrected, too, as its headings are; if not, they stay, and their
                uncertainty is considered (Schmidt 1966): a filtered velocity lags behind, which would bias them.
        """
        P, columns = self.covariance[rows], self._columns(rig)
        PH = P[..., columns] @ used.jacobians.swapaxes(-1, -2)
        gain = PH @ np.linalg.inv(used.covariances)
        gain[:, :, CLOCK:self._offset:RIG_SIZE] *= learn[:, None, None, None]
        self.mean[rows] += np.einsum('kfij,kfj->kfi', gain, used.residuals)
        half = gain @ (0.5 * used.covariances @ gain.swapaxes(-1, -2) - PH.swapaxes(-1, -2))
        P += half
        P += half.swapaxes(-1, -2)
        self.covariance[rows] = P
        self.modes[rows] = used.modes

    def learn_errors(self, used: Innovations) -> None:
        """Estimate the errors of images that rigs do not state: of calibrations, of where in a box the target is, of stamps.

        By Fisher's scoring of the likelihood of the innovations, which forgets (Mehra, Approaches to adaptive filtering, IEEE
        Trans. AC 17(5), 1972; Bar-Shalom, Li and Kirubarajan 2001, section 5.6).

        Parameters:
            used: of k directions, see `Innovations.pick`; of targets that several rigs observe.
        """
        inverse = np.linalg.inv(used.covariances)
        spread = np.einsum('kf,kfij,kfij->', used.modes, inverse, inverse)
        score = (np.sum(used.modes[..., None] * np.einsum('kfij,kfj->kfi', inverse, used.residuals) ** 2)
                 - np.einsum('kf,kfii->', used.modes, inverse))
        kept = (1.0 - 1.0 / UNSTATED_SIGHTINGS) ** len(inverse)
        self._unstated_information = kept * self._unstated_information + float(spread)
        self.unstated = max(self.unstated + float(score) / self._unstated_information, 0.0)

    def _given_rigs(self, P: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Dependence (..., 9, 2 r) of targets on headings and clocks, and covariances (..., 9, 9) if those were known."""
        n = self._offset
        gain = np.asarray(np.linalg.solve(P[..., :n, :n], P[..., :n, n:]), np.float64).swapaxes(-1, -2)
        return gain, P[..., n:, n:] - gain @ P[..., :n, n:]

    def _columns(self, rig: int) -> NDArray[np.intp]:
        """Indices (8,) of a rig's part of the state and of that of the target."""
        n = self._offset
        begin = RIG_SIZE * self.slots[rig]
        return np.concatenate([np.arange(begin, begin + RIG_SIZE), np.arange(n, n + MEASURED_SIZE)])


def prior_of(rig: RigSettings, settings: NetworkSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Covariance (2, 2) of a rig's heading correction (rad) and clock offset (s), and how fast (1/s) their variances (2,) grow.

    What is exact does not drift.

    Parameters:
        rig: what is known of it.
        settings: see `NetworkSettings`.
    """
    sigmas = np.array([rig.heading_sigma, rig.clock_sigma])
    drifts = np.array([settings.heading_drift, settings.clock_drift])
    return np.diag(np.maximum(sigmas, LEAST_SIGMA) ** 2), drifts**2 * (sigmas > 0.0)


def _moments(modes: NDArray[np.float64], means: NDArray[np.float64], covariances: NDArray[np.float64]
             ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means (k, N) and covariances (k, N, N) over all modes (k, f)."""
    mean, covariance = mixed(modes[:, :, None], means, covariances)
    return mean[:, 0], covariance[:, 0]


def _weighed(residuals: NDArray[np.float64], jacobians: NDArray[np.float64], S: NDArray[np.float64],
             modes: NDArray[np.float64]) -> Innovations:
    """Innovations with their densities, by probabilities (n, f) of the modes before."""
    determinant = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    x, y = residuals[..., 0], residuals[..., 1]
    squared = (S[..., 1, 1] * x**2 - 2.0 * S[..., 0, 1] * x * y + S[..., 0, 0] * y**2) / determinant
    each = np.log(modes)[:, None] - 0.5 * (squared + np.log(determinant)) - LOG_TAU
    largest = each.max(axis=2, keepdims=True)
    joint = np.exp(each - largest)
    total = joint.sum(axis=2)
    after = np.maximum(joint / total[:, :, None], LEAST_MODE)
    after /= after.sum(axis=2, keepdims=True)
    return Innovations(residuals, jacobians, S, after, np.sum(after * squared, axis=2), largest[:, :, 0] + np.log(total))


def largest_sigmas(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest standard deviations (n,) (m) of positions along any axis.

    Parameters:
        covariances (n, 9, 9): of the targets.
    """
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(covariances[:, :3, :3])[:, -1], 0.0)))
