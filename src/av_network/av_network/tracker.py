"""Tracks of targets with positions from the reports of several rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from av_network.calibration import RigCalibration
from av_network.hypothesis_filter import HypothesisFilter, Innovations, largest_sigmas
from av_network.lone_track import separate
from av_network.network_target import SUPPORT_S, WELL_SUPPORTED, NetworkTarget, TargetState, membership
from av_network.observation import GATE, MOST_TRACKS, Observation, Report, RigSettings
from av_network.packing import log_odds
from av_network.pairing import HOPELESS, MOST_CANDIDATES, MOST_SIGMA_M, Pairing
from av_network.reporting import COAST_S, target_states
from av_network.trust import RigTrust

MOST_DISTANCE_M = 400.0  # of a target from a rig; farther ones have no position
CONFIRMED = 0.95  # probability of existence from which a candidate becomes a track
LEAST_ODDS = math.log(CONFIRMED / (1.0 - CONFIRMED))  # the same
LEAST_AGE_S = 1.0  # for which a candidate is observed before
TARGET_DENSITY = 0.4  # 1/sr, of targets in a rig's sky that are not tracked yet, at the least
SKY = math.pi  # sr, of elevations from 0 to 30 deg, in which a rig's targets usually are
MEMBER_BONUS = 5.0  # logarithm of the odds that a rig's track stays with its target from one report to the next
DECISION_PERIOD_S = 0.25  # that of reports
NEVER = 1e6  # cost of an impossible assignment


class NetworkTracker:
    """Hypotheses of targets behind the tracks of several rigs, of which the probable ones are confirmed.

    A report's directions first go to the confirmed targets: the assignment of the largest likelihood, with a bonus for what was
    assigned before. Candidates follow the tracks that they consist of, whoever else does. Targets and candidates compete in a
    global hypothesis (`packing`): a candidate whose odds are high becomes a target, a target without odds ends. Reports are to
    come in the order of capture, see `ReportQueue`.

    Attributes:
        filter: states of all hypotheses.
        calibration: headings and clocks.
        hypotheses: in the order of the filter.
        unexplained: newest observation of each rig's track that belongs to no target, with its time by the reference clock.
        trust: the rigs that are used.

    Parameters:
        rigs: what is known of each.
        most_distance (m): of a target from a rig.
    """

    def __init__(self, rigs: Sequence[RigSettings], most_distance: float = MOST_DISTANCE_M) -> None:
        self._most_distance = most_distance
        self._known = list(rigs)
        self.rigs = {rig.name: index for index, rig in enumerate(rigs)}
        self._last_id = 0
        self.reset()

    def reset(self) -> None:
        """Forget all but the ids, as after a step of the clock."""
        self.filter = HypothesisFilter()
        self.calibration = RigCalibration(self._known)
        self.hypotheses: list[NetworkTarget] = []
        self.unexplained: dict[tuple[int, int], tuple[Observation, float]] = {}
        self._pairing = Pairing(self._most_distance)
        self.trust = RigTrust()
        self._decided = -math.inf
        self._density = TARGET_DENSITY  # 1/sr, of directions that are not tracked yet
        self._places: dict[int, NDArray[np.float64]] = {}  # of the rigs by their latest reports

    def join(self, rig: RigSettings) -> None:
        """Take the reports of one more rig. Raises ValueError for a name that is known already."""
        if rig.name in self.rigs:
            raise ValueError(f'{rig.name} takes part already')
        self.rigs[rig.name] = len(self._known)
        self._known.append(rig)
        self.calibration.join(rig)

    def new_id(self) -> int:
        """An id that no other target has."""
        self._last_id += 1
        return self._last_id

    def corrected_time(self, rig: int, time: float) -> float:
        """A rig's stamp by the reference clock (s).

        Parameters:
            rig: index of the rig.
            time (s): its stamp.
        """
        return time + self.calibration.known(rig).clock

    def use(self, report: Report) -> None:
        """Use a report. Raises KeyError for an unknown rig."""
        rig = self.rigs[report.rig]
        self._places[rig] = report.position
        time = self.corrected_time(rig, report.time)
        self.filter.predict(time)
        self.calibration.predict(time)
        known = self.calibration.known(rig)
        observations = [Observation(rig, report.position, one, known, 0.0 if one.by_sound else self.filter.unstated)
                        for one in report.sightings]
        if observations:
            self._use(rig, observations, time)
        self._tidy(time)

    def states(self, time: float) -> list[TargetState]:
        """All targets predicted to a time (s), by id; the tracker itself is not moved."""
        return target_states(self.filter, self.calibration, self.hypotheses, self._places, time)

    def _use(self, rig: int, observations: Sequence[Observation], time: float) -> None:
        """Associate, update, teach, and propose candidates."""
        innovations = self.filter.innovations(observations)
        assigned = self._assign(rig, observations, innovations, time)
        present = [each.tracks(time - SUPPORT_S) for each in self.hypotheses]
        self._judge(rig, observations, assigned, present, time)
        if rig not in self.trust:
            self._leave_out(rig)
            return
        # Directions that are not explained make chance meetings likely.
        self._density = max(TARGET_DENSITY, (len(observations) - len(assigned)) / SKY)
        # The tracks of probable hypotheses with several rigs need no other explanation.
        known = set().union(*(keys for each, keys in zip(self.hypotheses, present, strict=True)
                              if len(keys) >= WELL_SUPPORTED and (each.confirmed or each.score(keys) > LEAST_ODDS)))
        contested = [column for column, one in enumerate(observations) if one.key not in known]
        pairs = {row: column for column, row in assigned.items()}
        pairs |= self._follow(rig, observations, contested, innovations, time)
        self._update(rig, observations, pairs, innovations, time)
        self._teach(assigned, observations, time)
        for column, one in enumerate(observations):
            self.unexplained.pop(one.key, None)
            if column not in assigned:
                self.unexplained[one.key] = (one, time)
        for key in [key for key in self.unexplained if key[0] == rig][:-MOST_TRACKS]:  # whatever ids it makes up
            del self.unexplained[key]
        # What is where a target is that several rigs observe needs no other explanation.
        open_to_pairs = [observations[column] for column in contested if observations[column].sighting.resolved
                         and not (column in assigned and len(present[assigned[column]]) >= WELL_SUPPORTED)]
        self._pairing.propose(self.filter, self.hypotheses, open_to_pairs, self._density, time)

    def _judge(self, rig: int, observations: Sequence[Observation], assigned: dict[int, int],
               present: Sequence[set[tuple[int, int]]], time: float) -> None:
        """Note whether a rig reports what others observe, while two of them or more observe a target within its range."""
        def others(row: int) -> set[int]:
            return {other for other, _ in present[row] if other != rig and other in self.trust}

        means, reach = self.filter.targets()[0], self._most_distance
        confirmed = [row for row, each in enumerate(self.hypotheses) if each.confirmed]
        if any(np.linalg.norm(means[row, :3] - observations[0].position) < reach and len(others(row)) > 1 for row in confirmed):
            on, off = sum(len(present[row]) for row in confirmed), sum(other != rig for other, _ in self.unexplained)
            self.trust.note(rig, {one.sighting.id: column in assigned and bool(others(assigned[column]))
                                  for column, one in enumerate(observations)}, on / (on + off), time)

    def _leave_out(self, rig: int) -> None:
        """Forget what a rig has reported that contradicts the others."""
        for each in self.hypotheses:
            each.members.pop(rig, None)
            each.told.pop(rig, None)
        self.unexplained = {key: pair for key, pair in self.unexplained.items() if key[0] != rig}

    def _assign(self, rig: int, observations: Sequence[Observation], innovations: Innovations, time: float) -> dict[int, int]:
        """The target (index) of each observation (index) that stems from one."""
        rows = [row for row, each in enumerate(self.hypotheses) if each.confirmed]
        count = len(observations)
        if not rows:
            return {}
        own = membership(self.hypotheses, observations)[rows]
        costs = np.where(innovations.squared[rows] < GATE, -innovations.log_density[rows] - MEMBER_BONUS * own, NEVER)
        away = np.where(np.eye(count) > 0.0, -math.log(self._density), NEVER)
        pairs = zip(*linear_sum_assignment(np.hstack([costs.T, away])), strict=True)
        found = {int(column): rows[int(row)] for column, row in pairs if row < len(rows) and costs[row, column] < NEVER}
        for row, column in zip(*np.nonzero(own), strict=True):
            if found.get(int(column)) != rows[row]:
                del self.hypotheses[rows[row]].members[rig]
        return found

    def _follow(self, rig: int, observations: Sequence[Observation], contested: Sequence[int], innovations: Innovations,
                time: float) -> dict[int, int]:
        """The observation (index) of each candidate (index): that of its member, or a contested one if it has none."""
        own, found = membership(self.hypotheses, observations), {}
        for row, each in enumerate(self.hypotheses):
            if each.confirmed:
                continue
            if np.any(own[row]):
                column = int(np.argmax(own[row]))
                if innovations.squared[row, column] < GATE:
                    found[row] = column
                else:
                    del each.members[rig]
            elif contested and (rig not in each.members or time - each.members[rig].last > SUPPORT_S):
                column = min(contested, key=lambda column: float(innovations.squared[row, column]))
                if innovations.squared[row, column] < GATE:
                    found[row] = column
        return found

    def _update(self, rig: int, observations: Sequence[Observation], pairs: dict[int, int], innovations: Innovations,
                time: float) -> None:
        if not pairs:
            return
        rows, columns = np.array(list(pairs), int), np.array(list(pairs.values()), int)
        used, targets = [observations[column] for column in columns], [self.hypotheses[row] for row in rows]
        means = self.filter.targets()[0][rows, :3]
        picked = innovations.pick(rows, columns)
        members = [each.member(rig, one.sighting.id) for each, one in zip(targets, used, strict=True)]
        alone = separate([member.alone if member else None for member in members], used, means, self._density)
        gains = picked.log_density - [density for _, density in alone]
        for k, (each, one) in enumerate(zip(targets, used, strict=True)):
            each.note(one, time, float(picked.squared[k]), float(gains[k]), alone[k][0])
        self.filter.update(rows, picked)
        sure = np.array([not one.sighting.by_sound and each.confirmed and len(each.tracks(time - SUPPORT_S)) > 1
                         for each, one in zip(targets, used, strict=True)], bool)
        if np.any(sure):
            self.filter.learn_errors(Innovations(*(part[sure] for part in picked)))

    def _teach(self, assigned: dict[int, int], observations: Sequence[Observation], time: float) -> None:
        """Correct headings and clocks."""
        if self.calibration.is_exact:
            return
        means = self.filter.targets()[0]
        for column, row in assigned.items():
            self.calibration.note(self.hypotheses[row].id, observations[column], means[row, :6], time)

    def _tidy(self, time: float) -> None:
        """Confirm candidates, end those without hope and tracks that are lost; some times a second."""
        if abs(time - self._decided) < DECISION_PERIOD_S:
            return
        self._decided = time
        self.unexplained = {key: pair for key, pair in self.unexplained.items() if time - pair[1] < 2.0}
        self._prune(time)
        self._decide(time)

    def _prune(self, time: float) -> None:
        """End targets that are lost, and candidates that are refuted, silent, the same as a better one, or too many."""
        sigmas = largest_sigmas(self.filter.targets()[1])
        kept: list[int] = []
        used: list[set[tuple[int, int]]] = []
        candidates = 0
        present = [each.tracks(time - SUPPORT_S) for each in self.hypotheses]
        ranks = [(not each.confirmed, -each.score(keys)) for each, keys in zip(self.hypotheses, present, strict=True)]
        for row in sorted(range(len(ranks)), key=ranks.__getitem__):
            each, keys = self.hypotheses[row], present[row]
            if each.confirmed:
                ends = sigmas[row] > MOST_SIGMA_M or time - each.measured > COAST_S
            else:
                ends = (each.refuted or len(each.members) < 2 or each.score(each.tracks()) < HOPELESS
                        or sigmas[row] > 2.0 * MOST_SIGMA_M or time - each.measured > 2.0 or candidates >= MOST_CANDIDATES
                        or any(keys <= other or len(keys & other) >= WELL_SUPPORTED for other in used))
                candidates += not ends
            if not ends:
                used.append(keys)
                kept.append(row)
        self._keep(kept)

    def _keep(self, kept: Sequence[int]) -> None:
        if len(kept) == len(self.hypotheses):
            return
        for row in set(range(len(self.hypotheses))) - set(kept):
            self.calibration.forget(self.hypotheses[row].id)
        order = sorted(kept)
        self.hypotheses = [self.hypotheses[row] for row in order]
        self.filter.keep(order)

    def _decide(self, time: float) -> None:
        """Candidates become targets whose odds are high, old enough, and precise enough; targets without odds are disputed.

        A candidate claims none of the tracks of targets that several others support.
        """
        members = [each.tracks(time - SUPPORT_S) for each in self.hypotheses]
        owned = set().union(*(keys for each, keys in zip(self.hypotheses, members, strict=True)
                              if each.confirmed and len(keys) >= WELL_SUPPORTED))
        members = [keys if each.confirmed else keys - owned for each, keys in zip(self.hypotheses, members, strict=True)]
        scores = [each.score(keys) if len(keys) > 1 or each.confirmed else -math.inf
                  for each, keys in zip(self.hypotheses, members, strict=True)]
        odds = log_odds(scores, members)
        sigmas = largest_sigmas(self.filter.targets()[1])
        for row, each in enumerate(self.hypotheses):
            each.odds = float(odds[row])
            if each.confirmed:
                if len(members[row]) < 2:
                    each.odds = MEMBER_BONUS
            elif (each.odds >= LEAST_ODDS and time - each.started >= LEAST_AGE_S
                  and sigmas[row] < MOST_SIGMA_M):
                self._confirm(each, members[row], time)

    def _confirm(self, each: NetworkTarget, keys: set[tuple[int, int]], time: float) -> None:
        each.id = self.new_id()
        each.members = {rig: member for rig, member in each.members.items() if (rig, member.id) in keys}
        for key in each.tracks():
            self.unexplained.pop(key, None)
        for other in self.hypotheses:
            if other is each:
                continue
            if other.confirmed:
                other.members = {rig: member for rig, member in other.members.items() if (rig, member.id) not in keys}
            elif other.tracks() & keys:
                other.refuted = True
