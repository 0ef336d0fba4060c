"""Tracks of targets with positions from the reports of several rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from av_network.calibration import RigCalibration
from av_network.candidate import GATE, Candidate, largest_sigma, propose
from av_network.decorrelation import Decorrelation
from av_network.joint_filter import Innovations, JointFilter, Observation
from av_network.motion_model import nearly_constant_velocity
from av_network.network_target import NetworkTarget
from av_network.packing import log_odds
from av_network.report import Report
from av_network.settings import NetworkSettings, RigSettings

MEMBER_BONUS = 5.0  # logarithm of the odds that a rig's track stays with its target from one report to the next
RECENT_S = 0.6  # for which an unexplained sighting can be paired with that of another rig
TEACHING_SIGMA = 0.05  # of a position over its distance, up to which it teaches headings and clocks
MATURE_S = 2.0  # after which a target teaches headings and clocks
REPORTED_SHARE = 0.06  # of the distance from the nearest rig, up to which the standard deviation of a distant position may grow
CONSISTENT = 3.0  # mean normalised innovation squared up to which a position is reported
INCONSISTENT = 7.0  # mean normalised innovation squared at which a track ends, 2 being expected
SAME_SQUARED = 7.8  # Mahalanobis distance squared, 95 % of three degrees of freedom
SAME_S = 1.0  # for which two tracks must agree to become one
DECISION_PERIOD_S = 0.25
NEVER = 1e6  # cost of an impossible assignment


class TargetState(NamedTuple):
    """A target at a time.

    Parameters:
        target: what is known besides its state.
        existence: probability 0..1 that there is such a target.
        mean (6,), covariance (6, 6): position (m) and velocity (m/s) in ENU.
        rigs: indices of the rigs with recent observations.
        positioned: whether its position is known: precise, and consistent with its directions.
    """

    target: NetworkTarget
    existence: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    rigs: tuple[int, ...]
    positioned: bool


class NetworkTracker:
    """Joint estimate of targets, headings and clocks, with candidates for further targets.

    A report's directions first go to the confirmed targets: the assignment of the largest likelihood, with a bonus for what was
    assigned before. Those left over go to candidates, each of which supposes one target behind tracks of several rigs.
    Candidates compete in a global hypothesis (`packing`); one whose odds are high becomes a target. Reports are to come in the
    order of capture, see `ReportQueue`.

    Attributes:
        filter: targets, headings and clocks.
        targets: in the order of the filter.
        candidates: under examination.
        unexplained: newest observation of each rig's track that belongs to no target, with its time by the reference clock.

    Parameters:
        rigs: what is known of each.
        settings: see `NetworkSettings`.
    """

    def __init__(self, rigs: Sequence[RigSettings], settings: NetworkSettings | None = None) -> None:
        self.settings = settings or NetworkSettings()
        self._known = tuple(rigs)
        self.rigs = {rig.name: index for index, rig in enumerate(rigs)}
        self._last_id = 0
        self.reset()

    def reset(self) -> None:
        """Forget all but the ids, as after a step of the clock."""
        self.filter = JointFilter(self._known, self.settings)
        self.calibration = RigCalibration(self._known, self.settings)
        self.targets: list[NetworkTarget] = []
        self.candidates: list[Candidate] = []
        self.unexplained: dict[tuple[int, int], tuple[Observation, float]] = {}
        self._decorrelation = Decorrelation(self.settings.rig_manoeuvre)
        self._decided = -math.inf
        self._places: dict[int, NDArray[np.float64]] = {}  # of the rigs by their latest reports

    def new_id(self) -> int:
        """An id that no other target has."""
        self._last_id += 1
        return self._last_id

    def position_sigma(self, rig: str) -> float:
        """Standard deviation (m) of a rig's position along each axis."""
        return self._known[self.rigs[rig]].position_sigma

    def use(self, report: Report) -> None:
        """Use a report. Raises KeyError for an unknown rig."""
        rig = self.rigs[report.rig]
        self._places[rig] = report.position
        time = self.filter.corrected_time(rig, report.time)
        self.filter.predict(time)
        observations = [Observation(rig, report.position, report.time, sighting, covariance)
                        for sighting, covariance in self._decorrelation.fresh(report)]
        rest = self._use_for_targets(observations, time)
        if rest:
            self._use_for_candidates(rest, time)
        self._tidy(time)

    def states(self, time: float) -> list[TargetState]:
        """All targets predicted to a time (s), by id; the tracker itself is not moved."""
        found = []
        for index, target in enumerate(self.targets):
            mean, P = self.filter.target(index)
            step = 0.0 if self.filter.time is None else time - self.filter.time
            F, Q = (np.kron(part, np.eye(3)) for part in nearly_constant_velocity(step, self.settings.manoeuvre))
            rigs = tuple(sorted(rig for rig, (_, last) in target.members.items() if time - last < 1.0))
            existence = 0.99 * 0.5 ** (max(time - target.measured, 0.0) / self.settings.coast)
            mean, P = F @ mean, F @ P @ F.T + Q
            positioned = target.nis < CONSISTENT and self._is_precise(mean, P)
            found.append(TargetState(target, existence, mean, P, rigs, positioned))
        return sorted(found, key=lambda state: state.target.id)

    def _is_precise(self, mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> bool:
        distance = min((float(np.linalg.norm(mean[:3] - place)) for place in self._places.values()), default=0.0)
        return largest_sigma(covariance) <= max(self.settings.reported_sigma, REPORTED_SHARE * distance)

    def _use_for_targets(self, observations: Sequence[Observation], time: float) -> list[Observation]:
        """Update the targets; returns the observations that belong to none."""
        if not (self.targets and observations):
            return list(observations)
        rig = observations[0].rig
        innovations = [self.filter.innovations(one) for one in observations]
        costs = np.array([self._costs(one, each) for one, each in zip(observations, innovations, strict=True)])
        away = -math.log(self.settings.target_density)
        square = np.hstack([costs, np.where(np.eye(len(observations)) > 0.0, away, NEVER)])
        pairs = [(int(row), int(column)) for row, column in zip(*linear_sum_assignment(square), strict=True)
                 if column < len(self.targets) and costs[row, column] < NEVER]
        for row, column in pairs:
            one = observations[row]
            self.targets[column].note(rig, one.sighting, time, float(innovations[row].squared[column]))
            self.unexplained.pop((rig, one.sighting.id), None)
        self.filter.update([(column, observations[row]) for row, column in pairs])
        for row, column in pairs:
            if self._teaches(column, observations[0].position, time):
                state, _ = self.filter.target(column)
                if self.calibration.note(self.targets[column].id, observations[row], state, time):
                    self.filter.set_rigs(self.calibration.mean, self.calibration.covariance)
        used = {row for row, _ in pairs}
        return [one for row, one in enumerate(observations) if row not in used]

    def _teaches(self, index: int, origin: NDArray[np.float64], time: float) -> bool:
        """Whether a target corrects headings and clocks: not while it is new, or so imprecise that it is not linear."""
        distance = float(np.linalg.norm(self.filter.target(index)[0][:3] - origin))
        return (time - self.targets[index].born > MATURE_S
                and largest_sigma(self.filter.conditional_covariance(index)) < TEACHING_SIGMA * distance)

    def _costs(self, one: Observation, innovations: Innovations) -> NDArray[np.float64]:
        """Negative logarithms (n,) of the likelihood that an observation stems from each target."""
        dets = np.linalg.det(innovations.covariances)
        costs = 0.5 * innovations.squared + np.log(math.tau * np.sqrt(dets))
        for column, target in enumerate(self.targets):
            if target.members.get(one.rig, (0, 0.0))[0] == one.sighting.id:
                costs[column] -= MEMBER_BONUS
        return np.where(innovations.squared < GATE, costs, NEVER)

    def _use_for_candidates(self, rest: Sequence[Observation], time: float) -> None:
        for candidate in self.candidates:
            candidate.use(rest)
        fresh = {key: pair for key, pair in self.unexplained.items() if abs(time - pair[1]) < RECENT_S}
        proposed = [propose(self.filter, other, one, self.settings) for one in rest for key, (other, _) in fresh.items()
                    if key[0] != one.rig and one.sighting.resolved and other.sighting.resolved
                    and not (any({key, (one.rig, one.sighting.id)} <= each.keys for each in self.candidates))]
        self.candidates += [each for each in proposed if each is not None]
        for one in rest:
            self.unexplained[one.rig, one.sighting.id] = (one, time)

    def _tidy(self, time: float) -> None:
        """Confirm candidates, end those without hope and tracks that are lost, and join duplicates; some times a second."""
        if abs(time - self._decided) < DECISION_PERIOD_S:
            return
        self._decided = time
        self.unexplained = {key: pair for key, pair in self.unexplained.items() if time - pair[1] < 2.0}
        self._prune(time)
        self._confirm(time)
        self._end(time)
        self._join(time)

    def _prune(self, time: float) -> None:
        """Candidates end that are hopeless, silent, the same as a better one, or too many."""
        ranked = sorted(self.candidates, key=lambda each: -each.score)
        kept: list[Candidate] = []
        for each in ranked:
            newest = max(last for _, last in each.members.values())
            if not each.hopeless and time - newest < 2.0 and not any(each.keys <= other.keys for other in kept):
                kept.append(each)
        self.candidates = kept[:self.settings.most_candidates]

    def _confirm(self, time: float) -> None:
        """Candidates become targets whose odds are high, old enough, and precise enough."""
        least = math.log(self.settings.confirmed / (1.0 - self.settings.confirmed))
        odds = log_odds([each.score for each in self.candidates], [set(each.keys) for each in self.candidates])
        for each, odd in zip(list(self.candidates), odds, strict=True):
            if odd < least or time - each.started < self.settings.least_age or each.sigma() > self.settings.most_sigma:
                continue
            self.filter.adopt(each.filter)
            self.targets.append(NetworkTarget(self.new_id(), time, time, dict(each.members)))
            for key in each.keys:
                self.unexplained.pop(key, None)
            self.candidates = [other for other in self.candidates if not other.keys & each.keys]

    def _end(self, time: float) -> None:
        """Tracks end that are inconsistent, unsupported or imprecise."""
        for index in reversed(range(len(self.targets))):
            target = self.targets[index]
            lost = largest_sigma(self.filter.target(index)[1]) > self.settings.most_sigma
            if lost or target.nis > INCONSISTENT or time - target.measured > self.settings.coast:
                self._remove(index)

    def _join(self, time: float) -> None:
        """Of two tracks that agree for some time, and that no rig tells apart, the older one stays."""
        for second in reversed(range(len(self.targets))):
            for first in range(second):
                if self._same(first, second, time):
                    self.targets[second].duplicate_since = min(self.targets[second].duplicate_since, time)
                    break
            else:
                self.targets[second].duplicate_since = math.inf
                continue
            if time - self.targets[second].duplicate_since >= SAME_S:
                self._remove(second)

    def _same(self, first: int, second: int, time: float) -> bool:
        a, b = self.targets[first].members, self.targets[second].members
        if any(abs(a[rig][1] - b[rig][1]) < 0.5 and time - a[rig][1] < 1.0 for rig in a.keys() & b.keys()):
            return False
        mean, P = self.filter.difference(first, second)
        return float(mean[:3] @ np.linalg.solve(P[:3, :3], mean[:3])) < SAME_SQUARED

    def _remove(self, index: int) -> None:
        self.calibration.forget(self.targets[index].id)
        del self.targets[index]
        self.filter.remove(index)
