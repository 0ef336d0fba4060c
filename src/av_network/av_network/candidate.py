"""Two or more rigs' tracks that may be one target, against the hypothesis that they are different ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.angles import angles_to_direction, wrap
from av_network.joint_filter import RIG_SIZE, JointFilter, Observation
from av_network.motion_model import nearly_constant_velocity
from av_network.settings import NetworkSettings

WIDE_M = 300.0  # standard deviation of a position before the first observation
MOST_RELATIVE_SIGMA = 0.5  # of the distance, beyond which a position is not linear enough to begin with
GATE = 16.0  # of a squared Mahalanobis distance with two degrees of freedom: 0.03 % of true ones are beyond
JOINING_GATE = 9.0
HOPELESS = -4.0  # score from which a candidate ends
MOST_SCORE = 15.0
SILENT_S = 1.5  # after which another track of the same rig may take the place of one that is not reported any more
LOG_TAU = math.log(math.tau)


class LoneTarget:
    """A rig's track as a target of its own, in nearly uniform angular motion: the hypothesis to be compared with.

    Parameters:
        observation: the first one.
        distance (m): at which the target is supposed.
        settings: its speed and manoeuvres in m are those of the network's targets.
    """

    def __init__(self, observation: Observation, distance: float, settings: NetworkSettings) -> None:
        self._angles = np.array([observation.sighting.azimuth, observation.sighting.elevation])
        self._rates = np.zeros(2)
        rate, self._density = (settings.speed_sigma / distance) ** 2, settings.manoeuvre / distance**2
        self._P = np.array([np.diag([variance, rate]) for variance in np.diag(observation.covariance)])  # (2, 2, 2)
        self._time = observation.time

    def log_likelihood(self, observation: Observation) -> float:
        """Logarithm of the density (1/rad^2) of the next observation, which is used then."""
        step = observation.time - self._time
        F, Q = nearly_constant_velocity(step, self._density)
        self._P, self._time = F @ self._P @ F.T + Q, observation.time
        self._angles = self._angles + step * self._rates
        sighting = observation.sighting
        level = math.cos(sighting.elevation)
        residual = np.array([wrap(sighting.azimuth - float(self._angles[0])) * level, sighting.elevation - self._angles[1]])
        S = self._P[:, 0, 0] + np.diag(observation.covariance)
        gain = self._P[:, :, 0] / S[:, None]
        scale = np.array([1.0 / max(level, 0.1), 1.0])
        self._angles = self._angles + gain[:, 0] * residual * scale
        self._rates = self._rates + gain[:, 1] * residual * scale
        self._P = self._P - gain[:, :, None] * gain[:, None, :] * S[:, None, None]
        return float(-0.5 * np.sum(residual**2 / S) - LOG_TAU - 0.5 * np.sum(np.log(S)))


class Candidate:
    """A target that is supposed behind the tracks of several rigs, with the logarithm of its odds.

    Attributes:
        filter: the target's state.
        members: the rigs' tracks by rig, with the time of their latest observation.
        score: logarithm of the probability that they are one target over that they are different ones.
        started (s): time of the first observation by the reference clock.

    Parameters:
        start: filter of one target.
        score: at the beginning.
        observations: the first ones, of different rigs.
        settings: see `NetworkSettings`.
    """

    def __init__(self, start: JointFilter, score: float, observations: Sequence[Observation], settings: NetworkSettings
                 ) -> None:
        self.filter, self.score, self._settings = start, score, settings
        self.members: dict[int, tuple[int, float]] = {}
        self._lone: dict[int, LoneTarget] = {}
        self.started = start.time or 0.0
        self.hopeless = False
        for observation in observations:
            self._admit(observation)

    @property
    def keys(self) -> set[tuple[int, int]]:
        """The rigs' tracks: (index of the rig, id)."""
        return {(rig, identifier) for rig, (identifier, _) in self.members.items()}

    def use(self, observations: Sequence[Observation]) -> None:
        """Use one of the observations of a rig at one instant: that of the member, or one that fits if there is none."""
        rig = observations[0].rig
        time = self.filter.corrected_time(rig, observations[0].time)
        self.filter.predict(time)
        member = self.members.get(rig)
        own = next((one for one in observations if member is not None and one.sighting.id == member[0]), None)
        if own is not None:
            self._follow(own)
        elif member is None or time - member[1] > SILENT_S:
            each = [(one, self.filter.innovations(one)) for one in observations]
            one, innovations = min(each, key=lambda pair: float(pair[1].squared[0]))
            if innovations.squared[0] < JOINING_GATE:
                self._admit(one)
                self.score += self.filter.update([(0, one)], learn=True) - math.log(self._settings.target_density)
        self.score = min(self.score, MOST_SCORE)
        self.hopeless = self.hopeless or self.score < HOPELESS or self.sigma() > 2.0 * self._settings.most_sigma

    def sigma(self) -> float:
        """Largest standard deviation (m) of the position along any axis."""
        return largest_sigma(self.filter.target(0)[1])

    def _follow(self, one: Observation) -> None:
        innovations = self.filter.innovations(one)
        lone = self._lone[one.rig].log_likelihood(one)
        if innovations.squared[0] > 2.0 * GATE:
            self.hopeless = True
            return
        self.score += self.filter.update([(0, one)], learn=True) - lone
        self.members[one.rig] = (one.sighting.id, self.filter.time or 0.0)

    def _admit(self, one: Observation) -> None:
        self.members[one.rig] = (one.sighting.id, self.filter.time or 0.0)
        distance = float(np.linalg.norm(self.filter.target(0)[0][:3] - one.position))
        self._lone[one.rig] = LoneTarget(one, max(distance, 1.0), self._settings)


def propose(base: JointFilter, first: Observation, second: Observation, settings: NetworkSettings) -> Candidate | None:
    """A candidate from two directions of different rigs, None where they do not meet, or at an angle that gives no position.

    The prior density of targets is uniform within `most_distance`; the score is the Bayes factor of one target against two.

    Parameters:
        base: filter of the rigs.
        first, second: the directions.
        settings: see `NetworkSettings`.
    """
    place = meeting_point(base, first, second, settings.most_distance)
    if place is None:
        return None
    start = base.branch()
    start.predict(max(base.corrected_time(one.rig, one.time) for one in (first, second)))
    speed = settings.speed_sigma**2
    start.add(np.concatenate([place, np.zeros(3)]), np.diag([WIDE_M**2] * 3 + [speed] * 3))
    density = start.update([(0, first), (0, second)], learn=True)
    mean, P = start.target(0)
    nearest = min(float(np.linalg.norm(mean[:3] - one.position)) for one in (first, second))
    if largest_sigma(P) > min(MOST_RELATIVE_SIGMA * nearest, 2.0 * settings.most_sigma):
        return None
    # The prior of the update is Gaussian and wide; at its centre it is replaced by the uniform one.
    prior = math.log(3.0 * settings.target_density / settings.most_distance**3) + 1.5 * LOG_TAU + 3.0 * math.log(WIDE_M)
    score = density + prior - 2.0 * math.log(settings.target_density)
    return Candidate(start, score, (first, second), settings) if score > HOPELESS else None


def meeting_point(base: JointFilter, first: Observation, second: Observation, most_distance: float
                  ) -> NDArray[np.float64] | None:
    """The place (3,) (m) where two directions come closest, None where that is behind or beyond a distance from a rig.

    Parameters:
        base: filter of the rigs, whose heading corrections apply.
        first, second: the directions.
        most_distance (m): from either rig.
    """
    headings = [base.mean[RIG_SIZE * one.rig] for one in (first, second)]
    a, b = (angles_to_direction(one.sighting.azimuth + heading, one.sighting.elevation)
            for one, heading in zip((first, second), headings, strict=True))
    apart, cosine = second.position - first.position, float(a @ b)
    if 1.0 - cosine**2 < 1e-6:
        return None
    along_a = (apart @ a - cosine * (apart @ b)) / (1.0 - cosine**2)
    along_b = (cosine * (apart @ a) - apart @ b) / (1.0 - cosine**2)
    if not (0.0 < along_a < most_distance and 0.0 < along_b < most_distance):
        return None
    # Nearer to the direction that is more precise there.
    weights = [1.0 / (along**2 * np.trace(one.covariance)) for along, one in ((along_a, first), (along_b, second))]
    ends = first.position + along_a * a, second.position + along_b * b
    return np.asarray((weights[0] * ends[0] + weights[1] * ends[1]) / sum(weights))


def largest_sigma(covariance: NDArray[np.float64]) -> float:
    """Largest standard deviation (m) of a position along any axis.

    Parameters:
        covariance (6, 6): of position and velocity.
    """
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 0.0))
