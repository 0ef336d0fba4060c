"""Headings and clocks of the rigs from targets that several of them observe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from av_network import sphere
from av_network.apparent_direction import apparent_directions
from av_network.hypothesis_filter import RIG_SIZE, prior_of
from av_network.motion_model import nearly_constant_velocity
from av_network.observation import Observation
from av_network.settings import NetworkSettings, RigSettings

SEGMENT_S = 5.0
LEAST_OBSERVATIONS = 12
ITERATIONS = 2
DENSITY = 4.0  # m^2/s^3, of the acceleration
WIDE = np.diag([100.0**2] * 3 + [30.0**2] * 3)  # m^2, (m/s)^2: of a target at the beginning of a segment
OUTLIER = 16.0  # squared Mahalanobis distance of a residual from the smoothed track, beyond which it is not used


class _Linear(NamedTuple):
    """Observations of a segment about a track: y = H x + T dtheta + noise of covariance R."""

    y: NDArray[np.float64]  # (k, 2)
    H: NDArray[np.float64]  # (k, 2, 6)
    T: NDArray[np.float64]  # (k, 2, 2 r)
    R: NDArray[np.float64]  # (k, 2, 2)


class _Pass(NamedTuple):
    """A Kalman filter's states with their derivatives by dtheta, and what it says of dtheta."""

    means: NDArray[np.float64]  # (k, 6)
    covariances: NDArray[np.float64]  # (k, 6, 6)
    slopes: NDArray[np.float64]  # (k, 6, 2 r)
    information: NDArray[np.float64]  # (2 r, 2 r)
    vector: NDArray[np.float64]  # (2 r,)


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
    is smoothed, and the observations are linearised about the smoothed track (Gauss-Newton). The track is then eliminated:
    a Kalman filter carries the derivatives of its states by headings and clocks, and its innovations give their
    information (the separated bias of Friedland 1969). Each segment begins with a wide prior of the target, so
    that no observation counts twice.

    Attributes:
        mean (2 r,), covariance (2 r, 2 r): (heading (rad), clock (s)) of each rig.

    Parameters:
        rigs: what is known of each.
        slots: of each, see `HypothesisFilter`.
        settings: see `NetworkSettings`.
    """

    def __init__(self, rigs: Sequence[RigSettings], slots: Sequence[int], settings: NetworkSettings) -> None:
        self._settings = settings
        self.mean, self.covariance, self._drift = np.zeros(0), np.zeros((0, 0)), np.zeros(0)
        self._position_sigmas: list[float] = []
        self._slots: list[int] = []
        for rig, slot in zip(rigs, slots, strict=True):
            self.join(rig, slot)
        self._segments: dict[int, _Segment] = {}
        self._time: float | None = None

    def join(self, rig: RigSettings, slot: int) -> None:
        """Take part in what follows.

        Parameters:
            rig: what is known of it.
            slot: see `HypothesisFilter`.
        """
        self._position_sigmas.append(rig.position_sigma)
        self._slots.append(slot)
        if RIG_SIZE * slot == len(self.mean):
            covariance, drift = prior_of(rig, self._settings)
            self.mean = np.append(self.mean, np.zeros(RIG_SIZE))
            self.covariance = block_diag(self.covariance, covariance)
            self._drift = np.append(self._drift, drift)

    def note(self, target: int, observation: Observation, state: NDArray[np.float64], time: float) -> bool:
        """Note an observation of a target; returns whether headings and clocks have changed.

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
            return False
        del self._segments[target]
        if len(segment.observations) < LEAST_OBSERVATIONS or len({one.rig for one in segment.observations}) < 2:
            return False
        self._drift_to(time)
        self._learn(segment)
        return True

    def forget(self, target: int) -> None:
        """Drop the segment of a target whose track has ended."""
        self._segments.pop(target, None)

    def _drift_to(self, time: float) -> None:
        if self._time is not None:
            self.covariance += np.diag(self._drift * max(time - self._time, 0.0))
        self._time = time

    def _learn(self, segment: _Segment) -> None:
        clocks = self.mean[1::RIG_SIZE]
        order = np.argsort([one.time + clocks[self._slots[one.rig]] for one in segment.observations], kind='stable')
        observations = [segment.observations[k] for k in order]
        times = np.array([one.time + clocks[self._slots[one.rig]] for one in observations])
        track = np.array([segment.states[k] for k in order])
        step = np.zeros(len(self.mean))
        prior = np.linalg.inv(self.covariance)
        for _ in range(ITERATIONS):
            linear = self._linearise(observations, times, track, self.mean + step, step)
            passed = self._filter(times, linear, track[0])
            information = prior + passed.information
            step = np.asarray(np.linalg.solve(information, passed.vector), np.float64)
            track = self._smooth(times, passed, step)
        self.mean = self.mean + step
        self.covariance = np.asarray(np.linalg.inv(information), np.float64)

    def _linearise(self, observations: Sequence[Observation], times: NDArray[np.float64], track: NDArray[np.float64],
                   theta: NDArray[np.float64], step: NDArray[np.float64]) -> _Linear:
        """The observations about a track and headings and clocks `theta`, which are `step` from those at the beginning."""
        place = np.array([self._position_sigmas[one.rig] for one in observations])
        rigs = np.array([self._slots[one.rig] for one in observations])
        headings, clocks = theta[RIG_SIZE * rigs], theta[RIG_SIZE * rigs + 1]
        speed = np.array([self._settings.sound_speed if one.sighting.by_sound else math.inf for one in observations])
        ahead = np.array([one.time for one in observations]) + clocks - times
        origins = np.array([one.position for one in observations])
        expected = apparent_directions(track[:, :3], track[:, 3:], origins, ahead, speed)
        level = np.cos(expected.elevation)
        angles = np.array([one.angles for one in observations])
        residuals = sphere.offsets(angles + np.stack([headings, 0.0 * headings], 1),
                                   np.stack([expected.azimuth, expected.elevation], 1))
        H = np.concatenate([expected.by_position, expected.by_velocity], 2)
        T = np.zeros((len(rigs), 2, len(theta)))
        rows = np.arange(len(rigs))
        T[rows, 0, RIG_SIZE * rigs] = -level
        T[rows[:, None], [0, 1], RIG_SIZE * rigs[:, None] + 1] = expected.by_time
        place = (place / expected.distance) ** 2
        R = np.array([one.covariance for one in observations]) + place[:, None, None] * np.eye(2)
        R[np.einsum('ki,ki->k', residuals, np.linalg.solve(R, residuals[:, :, None])[:, :, 0]) > OUTLIER] *= 1e6
        return _Linear(residuals + np.einsum('kij,kj->ki', H, track) + T @ step, H, T, R)

    def _filter(self, times: NDArray[np.float64], linear: _Linear, begin: NDArray[np.float64]) -> _Pass:
        count, size = len(times), linear.T.shape[2]
        x, P, X = begin.copy(), WIDE.copy(), np.zeros((6, size))
        information, vector = np.zeros((size, size)), np.zeros(size)
        means, covariances, slopes = np.zeros((count, 6)), np.zeros((count, 6, 6)), np.zeros((count, 6, size))
        for k in range(count):
            if k:
                F, Q = self._motion(times[k] - times[k - 1])
                x, P, X = F @ x, F @ P @ F.T + Q, F @ X
            H = linear.H[k]
            S = H @ P @ H.T + linear.R[k]
            residual, slope = linear.y[k] - H @ x, linear.T[k] + H @ X
            inverse = np.linalg.inv(S)
            gain = P @ H.T @ inverse
            weighted = slope.T @ inverse
            information += weighted @ slope
            vector += weighted @ residual
            x, X, P = x + gain @ residual, X - gain @ slope, P - gain @ S @ gain.T
            means[k], covariances[k], slopes[k] = x, P, X
        return _Pass(means, covariances, slopes, information, vector)

    def _smooth(self, times: NDArray[np.float64], passed: _Pass, step: NDArray[np.float64]) -> NDArray[np.float64]:
        """The track (k, 6) given dtheta (Rauch, Tung and Striebel 1965)."""
        track = passed.means + passed.slopes @ step
        for k in range(len(times) - 2, -1, -1):
            F, Q = self._motion(times[k + 1] - times[k])
            P = passed.covariances[k]
            ahead = F @ P @ F.T + Q
            track[k] += P @ F.T @ np.linalg.solve(ahead, track[k + 1] - F @ track[k])
        return track

    def _motion(self, step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        F, _ = nearly_constant_velocity(step, 0.0)
        _, Q = nearly_constant_velocity(max(step, 1e-4), DENSITY)  # so that predicted covariances are regular
        axes = np.eye(3)
        return np.asarray(np.kron(F, axes), np.float64), np.asarray(np.kron(Q, axes), np.float64)
