"""Extended Kalman filters of all supposed targets at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network import motion_model, sphere
from av_network.apparent_direction import SOUND_SPEED, apparent_directions
from av_network.motion_model import AXES_SHARES, LEAST_STEP_S, mixed, mixing, target_motion, usual_modes
from av_network.observation import UNSTATED, Observation

MEASURED_SIZE, TARGET_SIZE = 6, 9
LOG_TAU = math.log(math.tau)
LEAST_MODE = 1e-3  # probability of a mode, so that it can return at once
# Of the variance of errors that rigs do not state: its standard deviation (rad^2) at first, and the number of directions from
# which it is learned, those of five rigs in 6 s.
UNSTATED_SPREAD, UNSTATED_SIGHTINGS = math.radians(0.3)**2, 120.0


class Innovations(NamedTuple):
    """Differences of m observations of one rig from what each of n targets would give, in each of f modes of flight.

    Parameters:
        residuals (n, m, f, 2) (rad): the differences.
        jacobians (n, m, f, 2, 6): their derivatives by position and velocity of the target.
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
    """Targets that fly steadily or manoeuvre, observed by rigs.

    Interacting multiple models: each of f modes of flight has a Gaussian of (position, velocity, acceleration), ENU. What is
    not known of a rig's heading and clock counts as a part of the error of each of its directions.

    Attributes:
        time (s): for which the states hold, by the reference clock; None before the first prediction.
        unstated (rad^2): variance of the errors of images that rigs do not state, see `learn_errors`.
        mean (n, f, 9), covariance (n, f, 9, 9): the states in each mode.
        modes (n, f): probabilities of the modes.
    """

    def __init__(self) -> None:
        self.unstated, self._unstated_information = UNSTATED, 2.0 / UNSTATED_SPREAD**2
        self.time: float | None = None
        flights = len(motion_model.MODES)
        self.mean, self.covariance = np.zeros((0, flights, TARGET_SIZE)), np.zeros((0, flights, TARGET_SIZE, TARGET_SIZE))
        self.modes = np.zeros((0, flights))

    def targets(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Means (n, 9) and covariances (n, 9, 9) of position, velocity and acceleration."""
        return _moments(self.modes, self.mean, self.covariance)

    def predicted(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Means (n, 9) and covariances (n, 9, 9) of the targets at a time (s); the filter itself is not moved."""
        return _moments(*self._ahead(time))

    def add(self, means: NDArray[np.float64], covariances: NDArray[np.float64]) -> None:
        """Add targets that are independent of all else.

        Parameters:
            means (k, 6), covariances (k, 6, 6): of position and velocity.
        """
        k, f = len(means), len(motion_model.MODES)
        mean, P = np.zeros((k, f, TARGET_SIZE)), np.zeros((k, f, TARGET_SIZE, TARGET_SIZE))
        mean[:, :, :MEASURED_SIZE], P[:, :, :MEASURED_SIZE, :MEASURED_SIZE] = means[:, None], covariances[:, None]
        for index, mode in enumerate(motion_model.MODES):
            P[:, index, MEASURED_SIZE:, MEASURED_SIZE:] = mode.sigma**2 * np.diag(AXES_SHARES)
        self.mean, self.covariance = np.concatenate([self.mean, mean]), np.concatenate([self.covariance, P])
        self.modes = np.concatenate([self.modes, np.tile(usual_modes(), (k, 1))])

    def keep(self, indices: Sequence[int]) -> None:
        """Keep some targets, in the order in which they are."""
        chosen = np.array(indices, int)
        self.mean, self.covariance, self.modes = self.mean[chosen], self.covariance[chosen], self.modes[chosen]

    def predict(self, time: float) -> None:
        """Move all states to a time (s) by the reference clock; one before theirs, or hardly later, changes nothing."""
        if self.time is not None and time - self.time < LEAST_STEP_S:
            return
        self.modes, self.mean, self.covariance = self._ahead(time)
        self.time = time

    def _ahead(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Probabilities of the modes, and means and covariances in each, at a time (s)."""
        step = 0.0 if self.time is None else time - self.time
        modes, shares = mixing(self.modes, np.full(len(self.mean), step))
        mean, P = mixed(shares, self.mean, self.covariance)
        F, Q = target_motion(step)
        return modes, np.einsum('fij,nfj->nfi', F, mean), F @ P @ F.swapaxes(-1, -2) + Q

    def innovations(self, observations: Sequence[Observation], rows: NDArray[np.intp] | None = None) -> Innovations:
        """Differences of a rig's observations from what the targets would give.

        Parameters:
            observations (m,): one at least, of one report.
            rows (n,): the targets; by default all.
        """
        first, rows = observations[0], np.arange(len(self.mean)) if rows is None else rows
        count, flights, m = len(rows), len(motion_model.MODES), len(observations)
        size = count * flights
        mean, P = self.mean[rows].reshape(size, TARGET_SIZE), self.covariance[rows].reshape(size, TARGET_SIZE, TARGET_SIZE)
        P = P[:, :MEASURED_SIZE, :MEASURED_SIZE]
        angles, noise = np.array([one.angles for one in observations]), np.array([one.covariance for one in observations])
        residuals, jacobians, S = np.empty((size, m, 2)), np.empty((size, m, 2, MEASURED_SIZE)), np.empty((size, m, 2, 2))
        alike: dict[tuple[bool, float], list[int]] = {}
        for index, one in enumerate(observations):
            alike.setdefault((one.sighting.by_sound, one.time), []).append(index)
        for (by_sound, time), chosen in alike.items():
            ahead = np.full(size, time - (self.time or 0.0))
            speed = np.full(size, SOUND_SPEED if by_sound else math.inf)
            expected = apparent_directions(mean[:, :3], mean[:, 3:MEASURED_SIZE], first.position, ahead, speed)
            residuals[:, chosen] = sphere.offsets(angles[chosen], expected.angles[:, None])
            H = expected.by_state
            late = first.known.clock_sigma**2 * expected.by_time[:, :, None] * expected.by_time[:, None]
            place = ((first.known.position_sigma / expected.distance) ** 2)[:, None, None] * np.eye(2)
            jacobians[:, chosen] = H[:, None]
            S[:, chosen] = (H @ P @ H.swapaxes(1, 2) + late + place)[:, None] + noise[chosen]

        def apart(part: NDArray[np.float64]) -> NDArray[np.float64]:
            return part.reshape(count, flights, *part.shape[1:]).swapaxes(1, 2)

        return _weighed(apart(residuals), apart(jacobians), apart(S), self.modes[rows])

    def update(self, rows: NDArray[np.intp], used: Innovations) -> None:
        """Use one observation for each of k targets.

        Parameters:
            rows (k,): the targets.
            used: of each, see `Innovations.pick`.
        """
        P = self.covariance[rows]
        PH = P[..., :MEASURED_SIZE] @ used.jacobians.swapaxes(-1, -2)
        gain = PH @ np.linalg.inv(used.covariances)
        self.mean[rows] += np.einsum('kfij,kfj->kfi', gain, used.residuals)
        half = gain @ (0.5 * used.covariances @ gain.swapaxes(-1, -2) - PH.swapaxes(-1, -2))
        self.covariance[rows] = P + half + half.swapaxes(-1, -2)  # keeps it symmetric
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
