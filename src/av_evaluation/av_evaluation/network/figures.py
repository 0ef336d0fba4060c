"""Figures of a network's tracker: errors, GOSPA, ghosts, consistency; the Cramer-Rao bound and least squares."""

from __future__ import annotations

import math
import time as wall
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from av_evaluation.metrics.metrics import rmse
from av_evaluation.metrics.tracks import gospa
from av_evaluation.network.simulation import Arrival, NetworkSimulation
from av_network import sphere
from av_network.network_target import TargetState
from av_network.observation import Report, RigSettings
from av_network.report_queue import ReportQueue
from av_network.stage import WAIT_S
from av_network.tracker import NetworkTracker

CUTOFF_M = 10.0  # an error from which a drone counts as missed and a track as false
STEP_S = 0.1  # between two looks at the targets
WINDOW_S = 0.8  # of the reports that are used by least squares: each camera has two or three, at four a second
EXPECTED_NEES = 3.0  # of positions


class OwnTracker:
    """`NetworkTracker` behind a `ReportQueue`, as the node runs them.

    Attributes:
        tracker: the tracker.

    Parameters:
        rigs: what it knows of each.
    """

    def __init__(self, rigs: Sequence[RigSettings]) -> None:
        self.tracker, self._queue = NetworkTracker(rigs), ReportQueue(WAIT_S)

    def take(self, report: Report) -> None:
        """Take a report that arrives."""
        rig = self.tracker.rigs[report.rig]
        self._queue.put(report, self.tracker.corrected_time(rig, report.time))

    def estimates(self, now: float) -> list[TargetState]:
        """The targets with a position at a time (s)."""
        for report in self._queue.ready(now):
            self.tracker.use(report)
        return [state for state in self.tracker.states(now) if state.existence >= 0.5 and state.positioned]


@dataclass
class NetworkRun:
    """What a tracker reported in a run, and the truth.

    Attributes:
        times (n,) (s), truths, estimates: per step.
        cost (s): processor time.
    """

    times: list[float] = field(default_factory=list)
    truths: list[NDArray[np.float64]] = field(default_factory=list)
    estimates: list[list[TargetState]] = field(default_factory=list)
    cost: float = 0.0

    def gospa(self, after: float) -> tuple[float, float, float]:
        """Mean GOSPA (m), missed and false targets from a time (s) on."""
        rows = []
        for time, truth, found in zip(self.times, self.truths, self.estimates, strict=True):
            if time >= after:
                each = gospa(_distances(truth, found), CUTOFF_M)
                rows.append((each.distance, each.missed, each.false))
        distance, missed, false = np.mean(rows, axis=0)
        return float(distance), float(missed) / (0.5 * CUTOFF_M**2), float(false) / (0.5 * CUTOFF_M**2)

    def longest_ghost(self) -> float:
        """Longest time (s) for which a track was farther than CUTOFF_M from every drone, without a break."""
        since: dict[int, float] = {}
        longest = 0.0
        for time, truth, found in zip(self.times, self.truths, self.estimates, strict=True):
            away = {one.target.id for one in found if not np.any(np.linalg.norm(truth - one.mean[:3], axis=1) < CUTOFF_M)}
            since = {name: since.get(name, time) for name in away}
            longest = max([longest, *(time - begun + STEP_S for begun in since.values())])
        return longest

    def matched(self, after: float) -> Iterable[tuple[float, NDArray[np.float64], TargetState]]:
        """Time (s), true position (3,) (m) and estimate of each pair within CUTOFF_M from a time (s) on."""
        for time, truth, found in zip(self.times, self.truths, self.estimates, strict=True):
            if time >= after:
                for row, column in gospa(_distances(truth, found), CUTOFF_M).assigned:
                    yield time, truth[row], found[column]

    def rmse(self, after: float) -> float:
        """Root mean square of the distances (m) between drones and their tracks from a time (s) on."""
        return rmse([np.linalg.norm(one.mean[:3] - true) for _, true, one in self.matched(after)])

    def nees(self, after: float) -> list[float]:
        """Normalised estimation errors squared of the positions, 3 being expected, from a time (s) on."""
        return [float((one.mean[:3] - true) @ np.linalg.solve(one.covariance[:3, :3], one.mean[:3] - true))
                for _, true, one in self.matched(after)]


def nees_bounds(means: Sequence[float]) -> tuple[float, float]:
    """Between which the mean over runs of their mean NEES is in 95 % of the cases if the filter is consistent.

    Errors along a run are correlated, so a run is one sample, and the spread of the runs tells the uncertainty of their mean
    (Student's t; the bounds of Bar-Shalom, Li and Kirubarajan 2001, section 5.4, suppose independent samples).

    Parameters:
        means (n,): of each run; fewer than two say nothing.
    """
    if len(means) < 2:
        return 0.0, math.inf
    low, high = stats.t.interval(0.95, len(means) - 1, loc=EXPECTED_NEES, scale=stats.sem(means))
    return float(low), float(high)


def run(peer: OwnTracker, simulation: NetworkSimulation, arrivals: Sequence[Arrival] | None = None) -> NetworkRun:
    """Run a tracker on the reports of a simulation.

    Parameters:
        peer: the tracker.
        simulation: reports and truth.
        arrivals: its reports, drawn already.
    """
    found = NetworkRun()
    waiting = list(arrivals if arrivals is not None else simulation.arrivals())[::-1]
    begun = wall.process_time()
    for now in np.arange(STEP_S, simulation.duration, STEP_S):
        while waiting and waiting[-1].time <= now:
            peer.take(waiting.pop().report)
        found.estimates.append(peer.estimates(float(now)))
        found.times.append(float(now))
    found.cost = wall.process_time() - begun
    found.truths = [simulation.truth(now) for now in found.times]
    return found


def _distances(truth: NDArray[np.float64], found: Sequence[TargetState]) -> NDArray[np.float64]:
    means = np.array([one.mean[:3] for one in found]).reshape(-1, 3)
    return np.linalg.norm(truth[:, None] - means[None], axis=2)


def position_bound(position: NDArray[np.float64], reports: Iterable[Report]) -> float:
    """Least root mean square error (m) of an unbiased position from one direction of each rig; inf where one is not enough.

    Parameters:
        position (3,) (m): of the target.
        reports: with the direction, of which only the covariance counts, as their first sighting.
    """
    information = np.zeros((3, 3))
    for report in reports:
        offset = position - report.position
        distance, level = float(np.linalg.norm(offset)), math.hypot(offset[0], offset[1])
        across = np.array([-offset[1], offset[0], 0.0]) / (level * distance)
        up = np.array([-offset[0] * offset[2], -offset[1] * offset[2], level**2]) / (level * distance**2)
        H = np.stack([across, up])
        information += H.T @ np.linalg.solve(report.sightings[0].covariance, H)
    if np.linalg.matrix_rank(information) < 3:
        return math.inf
    return math.sqrt(float(np.trace(np.linalg.inv(information))))


def mean_bound(simulation: NetworkSimulation, arrivals: Sequence[Arrival], after: float) -> float:
    """Root mean square over time of the bound (m) for a single drone that all rigs report always.

    Parameters:
        simulation: of one drone.
        arrivals: its reports.
        after (s): beginning.
    """
    latest: dict[str, Report] = {}
    bounds = []
    for arrival in arrivals:
        if arrival.report.sightings:
            latest[arrival.report.rig] = arrival.report
        if arrival.time >= after and len(latest) == len(simulation.rigs):
            bounds.append(position_bound(simulation.truth(arrival.time)[0], latest.values()))
    return rmse(bounds)


class Fit(NamedTuple):
    """A position (3,) (m) by least squares, at a time (s)."""

    time: float
    position: NDArray[np.float64]


def least_squares(reports: Sequence[Report], now: float) -> Fit | None:
    """Where a drone in uniform motion fits the directions of the last WINDOW_S best, at the newest time of these.

    Gauss-Newton from where the lines meet, without any prior; None where fewer than two rigs have two directions. Clocks and
    headings are taken for right.

    Parameters:
        reports: of one drone, that have arrived.
        now (s): the present.
    """
    used = [(report, one) for report in reports for one in report.sightings if now - one.measured < WINDOW_S]
    if sum(count > 1 for count in Counter(report.rig for report, _ in used).values()) < 2:
        return None
    places, times = np.array([report.position for report, _ in used]), np.array([one.measured for _, one in used])
    angles = np.array([(one.azimuth, one.elevation) for _, one in used])
    across = sphere.axes(angles)  # (k, 2, 3)
    time, distances = float(np.max(times)), np.ones(len(used))
    for _ in range(4):
        weights = 1.0 / (distances * np.sqrt([one.covariance[0, 0] for _, one in used]))
        rows = np.concatenate([across, (times - time)[:, None, None] * across], 2) * weights[:, None, None]
        values = np.einsum('kij,kj->ki', across, places) * weights[:, None]
        state = np.linalg.lstsq(rows.reshape(-1, 6), values.reshape(-1), rcond=None)[0]
        distances = np.maximum(np.linalg.norm(state[:3] - places, axis=1), 1.0)
    return Fit(time, state[:3])


class FlightFigures(NamedTuple):
    """How well a drone is followed that two rigs or more measure.

    Parameters:
        rmse (m): of the tracker for the time of the newest direction that it has used.
        squares (m): of `least_squares` at the same steps.
        present (m): of the tracker for the present, which is later.
        coverage: share of the steps at which two rigs or more measure it with a position.
        nees: mean normalised estimation error squared of the position, 3 being expected.
        names: number of ids.
    """

    rmse: float
    squares: float
    present: float
    coverage: float
    nees: float
    names: int


def follow(peer: OwnTracker, simulation: NetworkSimulation, settled: float = 3.0) -> FlightFigures:
    """Run a tracker on a flight of one drone.

    Parameters:
        peer: the tracker.
        simulation: the flight.
        settled (s): beginning, which is not counted.
    """
    waiting, arrived, names, rows = simulation.arrivals()[::-1], [], set(), []
    both = reported = 0
    for now in np.arange(STEP_S, simulation.duration, STEP_S).tolist():
        while waiting and waiting[-1].time <= now:
            arrived.append(waiting.pop().report)
            peer.take(arrived[-1])
        found = peer.estimates(now)
        names |= {one.target.id for one in found}
        fit = least_squares(arrived[-40:], now)
        if fit is None or now < settled:
            continue
        both, reported = both + 1, reported + bool(found)
        if found:
            latest = peer.tracker.filter.time or 0.0
            state = next(each for each in peer.tracker.states(latest) if each.target.id == found[0].target.id)
            error, ahead = (state.mean[:3] - simulation.truth(latest)[0], found[0].mean[:3] - simulation.truth(now)[0])
            rows.append((error @ error, np.sum((fit.position - simulation.truth(fit.time)[0]) ** 2), ahead @ ahead,
                         ahead @ np.linalg.solve(found[0].covariance[:3, :3], ahead)))
    squared, fitted, ahead, nees = np.mean(rows, axis=0) if rows else np.full(4, math.nan)
    return FlightFigures(math.sqrt(squared), math.sqrt(fitted), math.sqrt(ahead), reported / max(both, 1), float(nees),
                         len(names))
