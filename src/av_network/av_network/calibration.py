"""Headings and clocks of the rigs from targets that several of them observe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solveh_banded

from av_network import sphere
from av_network.apparent_direction import SOUND_SPEED, apparent_directions
from av_network.motion_model import LEAST_STEP_S, motion
from av_network.observation import Observation, RigState
from av_network.settings import RigSettings

RIG_SIZE, HEADING, CLOCK = 2, 0, 1  # of the part of the state of one rig
HEADING_DRIFT, CLOCK_DRIFT = math.radians(0.01), 1e-4  # rad and s per sqrt(s): random walks of headings and clock offsets
LEAST_SIGMA = 1e-6  # of what counts as known, so that covariances stay regular
SEGMENT_S = 2.5  # of a track, ten reports of each rig
LEAST_OBSERVATIONS = 12  # of a segment: four numbers for each of the six of its track
ITERATIONS = 2  # after one, clocks are up to 60 ms off (`network offsets`), after two 8
DENSITY = 4.0  # m^2/s^3, of the acceleration
WIDE = np.diag([100.0**2] * 3 + [30.0**2] * 3)  # m^2, (m/s)^2: of a target at the beginning of a segment
OUTLIER = 16.0  # squared Mahalanobis distance of a residual from the smoothed track, beyond which it is not used


class _Linear(NamedTuple):
    """Observations of a segment about a track: y = H x + T dtheta + noise of covariance R."""

    y: NDArray[np.float64]  # (k, 2)
    H: NDArray[np.float64]  # (k, 2, 6)
    T: NDArray[np.float64]  # (k, 2, 2 r)
    R: NDArray[np.float64]  # (k, 2, 2)


@dataclass
class _Segment:
    """The observations of one target, each with the target's state at its time."""

    begin: float
    observations: list[Observation] = field(default_factory=list)
    states: list[NDArray[np.float64]] = field(default_factory=list)


class RigCalibration:
    """Estimates the heading correction and clock offset of each rig from segments of shared tracks.

    A recursive filter of targets and clocks is biased: the offset of a clock enters multiplied by the velocity, a filtered
    velocity lags behind the true one, and its error correlates with the innovations. Here each segment of a target's track
    is smoothed, and the observations are linearised about the smoothed track (Gauss-Newton). The track is then eliminated
    from the normal equations, whose matrix is banded. Each segment begins with a wide prior of the target, so that no
    observation counts twice. Errors of images that rigs do not state last for a segment, as if its headings were off by them.

    Attributes:
        mean (2 r,), covariance (2 r, 2 r): (heading (rad), clock (s)) of each rig.

    Parameters:
        rigs: what is known of each.
    """

    def __init__(self, rigs: Sequence[RigSettings]) -> None:
        self.mean, self.covariance, self._drift = np.zeros(0), np.zeros((0, 0)), np.zeros(0)
        self._position_sigmas: list[float] = []
        self._segments: dict[int, _Segment] = {}
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
    def heading_variances(self) -> NDArray[np.float64]:
        """Of each rig (rad^2)."""
        return self.covariance.diagonal()[HEADING::RIG_SIZE]

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
        segment = self._segments.setdefault(target, _Segment(time))
        if time - segment.begin < SEGMENT_S:
            segment.observations.append(observation)
            segment.states.append(state)
            return
        del self._segments[target]
        if len(segment.observations) >= LEAST_OBSERVATIONS and len({one.rig for one in segment.observations}) > 1:
            self._learn(segment)

    def forget(self, target: int) -> None:
        """Drop the segment of a target whose track has ended."""
        self._segments.pop(target, None)

    def predict(self, time: float) -> None:
        """Let headings and clocks drift until a time (s) by the reference clock."""
        if self._time is not None:
            self.covariance += np.diag(self._drift * max(time - self._time, 0.0))
        self._time = time

    def _learn(self, segment: _Segment) -> None:
        observations, clocks = segment.observations, self.mean[CLOCK::RIG_SIZE]
        times = np.array([one.sighting.measured + clocks[one.rig] for one in observations])
        cells, first, nodes = np.unique(np.floor(times / LEAST_STEP_S), return_index=True, return_inverse=True)
        track, ahead = np.array(segment.states)[first], times - LEAST_STEP_S * (cells[nodes] + 0.5)
        bands, prior = _motion_bands(LEAST_STEP_S * np.diff(cells)), np.linalg.inv(self.covariance)
        step = np.zeros(len(self.mean))
        lasting = max(one.unstated for one in observations) * (np.arange(len(step)) % RIG_SIZE == HEADING)
        for _ in range(ITERATIONS):
            linear = self._linearise(observations, ahead, track[nodes], step)
            weights = np.linalg.inv(linear.R)
            weighed_H, weighed_T = weights @ linear.H, weights @ linear.T
            matrix, vectors, shared = bands.copy(), np.zeros_like(track), np.zeros((*track.shape, len(step)))
            np.add.at(matrix[:, :6], nodes, linear.H.swapaxes(1, 2) @ weighed_H)
            np.add.at(vectors, nodes, np.einsum('kia,ki->ka', weighed_H, linear.y))
            np.add.at(shared, nodes, linear.H.swapaxes(1, 2) @ weighed_T)
            vectors[0] += np.linalg.solve(WIDE, track[0])
            both = np.concatenate([vectors[..., None], shared], 2).reshape(track.size, -1)
            solved = solveh_banded(_banded(matrix), both, lower=True)
            added = np.einsum('kit,kiu->tu', linear.T, weighed_T) - both[:, 1:].T @ solved[:, 1:]
            damped = np.linalg.inv(np.eye(len(step)) + added * lasting)
            information = prior + damped @ added
            step = np.asarray(np.linalg.solve(information, damped @ (np.einsum('kit,ki->t', weighed_T, linear.y)
                                                                     - both[:, 1:].T @ solved[:, 0])), np.float64)
            track = (solved[:, 0] - solved[:, 1:] @ step).reshape(track.shape)
        self.mean = self.mean + step
        self.covariance = np.asarray(np.linalg.inv(0.5 * (information + information.T)), np.float64)

    def _linearise(self, observations: Sequence[Observation], ahead: NDArray[np.float64], track: NDArray[np.float64],
                   step: NDArray[np.float64]) -> _Linear:
        """The observations about states of the target, of which they are ahead, and headings and clocks that are `step` off."""
        place, unstated = np.array([(one.known.position_sigma, one.unstated) for one in observations]).T
        rigs = np.array([one.rig for one in observations])
        headings, clocks = (self.mean + step)[RIG_SIZE * rigs], step[RIG_SIZE * rigs + CLOCK]
        speed = np.array([SOUND_SPEED if one.sighting.by_sound else math.inf for one in observations])
        origins = np.array([one.position for one in observations])
        expected = apparent_directions(track[:, :3], track[:, 3:], origins, ahead + clocks, speed)
        level = np.cos(expected.elevation)
        angles = np.array([(one.sighting.azimuth, one.sighting.elevation) for one in observations])
        residuals = sphere.offsets(angles + np.stack([headings, 0.0 * headings], 1),
                                   np.stack([expected.azimuth, expected.elevation], 1))
        H = np.concatenate([expected.by_position, expected.by_velocity], 2)
        T = np.zeros((len(rigs), 2, len(step)))
        rows = np.arange(len(rigs))
        T[rows, 0, RIG_SIZE * rigs] = -level
        T[rows[:, None], [0, 1], RIG_SIZE * rigs[:, None] + CLOCK] = expected.by_time
        unstated = unstated + (place / expected.distance) ** 2
        R = np.array([one.sighting.covariance for one in observations]) + unstated[:, None, None] * np.eye(2)
        S = R + T @ self.covariance @ T.swapaxes(1, 2)
        R[np.einsum('ki,ki->k', residuals, np.linalg.solve(S, residuals[:, :, None])[:, :, 0]) > OUTLIER] *= 1e6
        return _Linear(residuals + np.einsum('kij,kj->ki', H, track) + T @ step, H, T, R)


def _motion_bands(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Information of a track's motion and beginning: (k + 1, 12, 6) of each state (rows 0 to 5) and the next one with it.

    Parameters:
        steps (k,) (s): between the states.
    """
    found = np.zeros((len(steps) + 1, 12, 6))
    F, Q = (np.kron(part, np.eye(3)) for part in motion(steps, np.array([[0.0, 1.0], [0.0, 0.0]]), DENSITY))
    inverse = np.linalg.inv(Q)
    found[:-1, 6:] = -inverse @ F
    found[:-1, :6] -= F.swapaxes(1, 2) @ found[:-1, 6:]
    found[1:, :6] += inverse
    found[0, :6] += np.linalg.inv(WIDE)
    return found


def _banded(blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower diagonals (12, 6 k) of a matrix by its blocks (k, 12, 6), see `_motion_bands`."""
    below, column = np.indices((12, 6))
    padded = np.pad(blocks, ((0, 0), (0, 6), (0, 0)))
    return np.asarray(padded[:, below + column, column].transpose(1, 0, 2).reshape(12, -1))
