"""Headings and clocks of the rigs from targets that several of them observe."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from av_network import sphere
from av_network.apparent_direction import SOUND_SPEED, apparent_directions
from av_network.motion_model import motion
from av_network.observation import GATE, Observation, RigSettings, RigState

RIG_SIZE, HEADING, CLOCK = 2, 0, 1  # of the part of the state of one rig
HEADING_DRIFT, CLOCK_DRIFT = math.radians(0.01), 1e-4  # rad and s per sqrt(s): random walks of headings and clock offsets
LEAST_SIGMA = 1e-6  # of what counts as known, so that covariances stay regular
SEGMENT_S = 2.5  # of a track, ten reports of each rig
STEP_S = 0.1  # between the states of its track; with 0.25 s clocks are 14 ms off (`network offsets`), with 0.05 s 6
ITERATIONS = 2  # after one, clocks are up to 60 ms off, after two 8
DENSITY = 4.0  # m^2/s^3, of the acceleration
WIDE = np.diag([100.0**2] * 3 + [30.0**2] * 3)  # m^2, (m/s)^2: of a target at the beginning of a segment


# The observations of one target, each with the target's state (6,) at its time (s).
Segment = list[tuple[Observation, NDArray[np.float64], float]]


class RigCalibration:
    """Estimates the heading correction and clock offset of each rig from segments of shared tracks.

    A recursive filter of targets and clocks is biased: the offset of a clock enters multiplied by the velocity, a filtered
    velocity lags behind the true one, and its error correlates with the innovations. Here each segment of a target's track
    is smoothed, and the observations are linearised about the smoothed track (Gauss-Newton). The track is then eliminated
    from the normal equations. Each segment begins with a wide prior of the target, so that no
    observation counts twice. Errors of images that rigs do not state last for a segment, as if its headings were off by them.

    Attributes:
        mean (2 r,), covariance (2 r, 2 r): (heading (rad), clock (s)) of each rig.

    Parameters:
        rigs: what is known of each.
    """

    def __init__(self, rigs: Sequence[RigSettings]) -> None:
        self.mean, self.covariance, self._drift = np.zeros(0), np.zeros((0, 0)), np.zeros(0)
        self._position_sigmas: list[float] = []
        self._segments: dict[int, Segment] = {}
        self._time: float | None = None
        for rig in rigs:
            self.join(rig)

    def join(self, rig: RigSettings) -> None:
        """Take part in what follows. What is exact does not drift."""
        sigmas = np.array([rig.heading_sigma, rig.clock_sigma])
        drifts = np.array([HEADING_DRIFT, CLOCK_DRIFT])
        self.mean = np.append(self.mean, np.zeros(RIG_SIZE))
        self.covariance = block_diag(self.covariance, np.diag(np.maximum(sigmas, LEAST_SIGMA) ** 2))
        self._drift = np.append(self._drift, drifts**2 * (sigmas > 0.0))
        self._position_sigmas.append(rig.position_sigma)

    def known(self, rig: int) -> RigState:
        """What is known of a rig, by its index."""
        part = slice(RIG_SIZE * rig, RIG_SIZE * (rig + 1))
        (heading, clock), (turned, late) = self.mean[part].tolist(), np.sqrt(self.covariance.diagonal()[part]).tolist()
        return RigState(heading, clock, turned, late, self._position_sigmas[rig])

    @property
    def is_exact(self) -> bool:
        """Whether all headings and clocks are."""
        return not np.any(self._drift)

    def note(self, target: int, observation: Observation, state: NDArray[np.float64], time: float) -> None:
        """Note an observation of a target; headings and clocks are corrected at the end of a segment.

        Parameters:
            target: the target's id.
            observation: of it.
            state (6,): of the target at that time.
            time (s): by the reference clock.
        """
        segment = self._segments.setdefault(target, [])
        if not segment or time - segment[0][2] < SEGMENT_S:
            segment.append((observation, state, time))
            return
        del self._segments[target]
        if len({one.rig for one, _, _ in segment}) > 1:
            self._learn(segment)

    def forget(self, target: int) -> None:
        """Drop the segment of a target whose track has ended."""
        self._segments.pop(target, None)

    def predict(self, time: float) -> None:
        """Let headings and clocks drift until a time (s) by the reference clock."""
        if self._time is not None:
            self.covariance += np.diag(self._drift * max(time - self._time, 0.0))
        self._time = time

    def _learn(self, segment: Segment) -> None:
        (observations, states, _), clocks = zip(*segment, strict=True), self.mean[CLOCK::RIG_SIZE]
        times = np.array([one.sighting.measured + clocks[one.rig] for one in observations])
        cells, first, nodes = np.unique(np.floor(times / STEP_S), return_index=True, return_inverse=True)
        track, ahead = np.array(states)[first], times - STEP_S * (cells[nodes] + 0.5)
        rigs = np.array([one.rig for one in observations])
        flight, prior = _motion_information(STEP_S * np.diff(cells)), np.linalg.inv(self.covariance)
        step, size = np.zeros(len(self.mean)), track.size
        columns = np.concatenate([6 * nodes[:, None] + np.arange(6), size + RIG_SIZE * rigs[:, None] + np.arange(RIG_SIZE)], 1)
        lasting = max(one.unstated for one in observations) * (np.arange(len(step)) % RIG_SIZE == HEADING)
        for _ in range(ITERATIONS):
            y, J, R = self._linearise(observations, rigs, ahead, np.append(track, step)[columns])
            weighed = np.linalg.solve(R, J)
            matrix, vector = np.zeros((size + len(step),) * 2), np.zeros(size + len(step))
            np.add.at(matrix, (columns[:, :, None], columns[:, None]), J.swapaxes(1, 2) @ weighed)
            np.add.at(vector, columns, np.einsum('kia,ki->ka', weighed, y))
            vector[:6] += np.linalg.solve(WIDE, track[0])
            solved = np.linalg.solve(matrix[:size, :size] + flight, np.column_stack([vector[:size], matrix[:size, size:]]))
            added = matrix[size:, size:] - matrix[size:, :size] @ solved[:, 1:]
            damped = np.linalg.inv(np.eye(len(step)) + added * lasting)
            information = prior + damped @ added
            step = np.asarray(np.linalg.solve(information, damped @ (vector[size:] - matrix[size:, :size] @ solved[:, 0])))
            track = (solved[:, 0] - solved[:, 1:] @ step).reshape(track.shape)
        self.mean = self.mean + step
        self.covariance = np.asarray(np.linalg.inv(0.5 * (information + information.T)), np.float64)

    def _linearise(self, observations: Sequence[Observation], rigs: NDArray[np.intp], ahead: NDArray[np.float64],
                   x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The k observations as y (k, 2) = J x + noise of covariance R (k, 2, 2), with J (k, 2, 8).

        Parameters:
            observations (k,), rigs (k,): of the segment, and the rigs that they are of.
            ahead (k,) (s): by how much each is later than a state of the track.
            x (k, 8): that state (position and velocity), and what heading and clock of the rig are off.
        """
        place, unstated = np.array([(one.known.position_sigma, one.unstated) for one in observations]).T
        speed = np.array([SOUND_SPEED if one.sighting.by_sound else math.inf for one in observations])
        origins = np.array([one.position for one in observations])
        expected = apparent_directions(x[:, :3], x[:, 3:6], origins, ahead + x[:, 6 + CLOCK], speed)
        angles = np.array([(one.sighting.azimuth, one.sighting.elevation) for one in observations])
        angles[:, 0] += self.mean[RIG_SIZE * rigs + HEADING] + x[:, 6 + HEADING]
        residuals = sphere.offsets(angles, expected.angles)
        J = np.concatenate([expected.by_state, np.zeros_like(expected.by_state[:, :, :RIG_SIZE])], 2)
        J[:, 0, 6 + HEADING] = -np.cos(expected.angles[:, 1])
        J[:, :, 6 + CLOCK] = expected.by_time
        unstated = unstated + (place / expected.distance) ** 2
        R = np.array([one.sighting.covariance for one in observations]) + unstated[:, None, None] * np.eye(2)
        own = RIG_SIZE * rigs[:, None] + np.arange(RIG_SIZE)
        S = R + J[:, :, 6:] @ self.covariance[own[:, :, None], own[:, None]] @ J[:, :, 6:].swapaxes(1, 2)
        R[np.einsum('ki,ki->k', residuals, np.linalg.solve(S, residuals[:, :, None])[:, :, 0]) > GATE] *= 1e6  # not used
        return residuals + np.einsum('kia,ka->ki', J, x), J, R


def _motion_information(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Information (6 n, 6 n) of the n states of a track by its motion and its beginning.

    Parameters:
        steps (n - 1,) (s): between the states.
    """
    F, Q = (np.kron(part, np.eye(3)) for part in motion(steps, np.array([[0.0, 1.0], [0.0, 0.0]]), DENSITY))
    changes = np.eye(6 * len(steps) + 6)
    for k, each in enumerate(F):
        changes[6 * k + 6:6 * k + 12, 6 * k:6 * k + 6] = -each
    return np.asarray(changes.T @ np.linalg.inv(block_diag(WIDE, *Q)) @ changes)
