"""Figures of a tracker of a network: errors, GOSPA, ghosts, consistency, and its estimates of clocks and headings."""

from __future__ import annotations

import math
import time as wall
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from av_evaluation.metrics.gospa import gospa
from av_evaluation.network.simulation import Arrival, NetworkSimulation
from av_network.report import Report
from av_network.report_queue import ReportQueue
from av_network.settings import NetworkSettings, RigSettings
from av_network.tracker import NetworkTracker

CUTOFF_M = 10.0  # an error from which a drone counts as missed and a track as false
STEP_S = 0.1
EXPECTED_NEES = 3.0  # of positions


class Estimate(NamedTuple):
    """A reported target: its id, mean (6,) and covariance (6, 6) of position and velocity."""

    id: int
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


class NetworkPeer(Protocol):
    """A tracker of positions from directions."""

    def take(self, report: Report, now: float) -> None:
        """Take a report.

        Parameters:
            report: of a rig.
            now (s): time of its arrival.
        """

    def estimates(self, now: float) -> list[Estimate]:
        """The targets at a time (s)."""


class OwnTracker:
    """`NetworkTracker` behind a `ReportQueue`, as the node runs them.

    Attributes:
        tracker: the tracker.

    Parameters:
        rigs: what it knows of each.
        settings: see `NetworkSettings`.
        wait (s): see `ReportQueue`.
    """

    def __init__(self, rigs: Sequence[RigSettings], settings: NetworkSettings | None = None, wait: float = 0.5) -> None:
        self.tracker, self._queue = NetworkTracker(rigs, settings), ReportQueue(wait)

    def take(self, report: Report, now: float) -> None:
        """See `NetworkPeer`."""
        rig = self.tracker.rigs[report.rig]
        self._queue.put(report, self.tracker.filter.corrected_time(rig, report.time))

    def estimates(self, now: float) -> list[Estimate]:
        """See `NetworkPeer`."""
        for report in self._queue.ready(now):
            self.tracker.use(report)
        return [Estimate(state.target.id, state.mean, state.covariance) for state in self.tracker.states(now)
                if state.existence >= 0.5 and state.positioned]


@dataclass
class NetworkRun:
    """What a tracker reported in a run, and the truth.

    Attributes:
        times (n,) (s), truths, estimates: per step.
        cost (s): processor time.
    """

    times: list[float] = field(default_factory=list)
    truths: list[NDArray[np.float64]] = field(default_factory=list)
    estimates: list[list[Estimate]] = field(default_factory=list)
    cost: float = 0.0

    def gospa(self, after: float = 0.0) -> tuple[float, float, float]:
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
            away = {one.id for one in found if not np.any(np.linalg.norm(truth - one.mean[:3], axis=1) < CUTOFF_M)}
            since = {name: since.get(name, time) for name in away}
            longest = max([longest, *(time - begun + STEP_S for begun in since.values())])
        return longest

    def matched(self, after: float = 0.0) -> Iterable[tuple[float, NDArray[np.float64], Estimate]]:
        """Time (s), true position (3,) (m) and estimate of each pair within CUTOFF_M from a time (s) on."""
        for time, truth, found in zip(self.times, self.truths, self.estimates, strict=True):
            if time >= after:
                for row, column in gospa(_distances(truth, found), CUTOFF_M).assigned:
                    yield time, truth[row], found[column]

    def rmse(self, after: float = 0.0) -> float:
        """Root mean square of the distances (m) between drones and their tracks from a time (s) on."""
        squared = [float(np.sum((one.mean[:3] - true) ** 2)) for _, true, one in self.matched(after)]
        return math.sqrt(float(np.mean(squared))) if squared else math.nan

    def nees(self, after: float = 0.0) -> list[float]:
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
    width = float(student.ppf(0.975, len(means) - 1) * np.std(means, ddof=1)) / math.sqrt(len(means))
    return EXPECTED_NEES - width, EXPECTED_NEES + width


def run(peer: NetworkPeer, simulation: NetworkSimulation, arrivals: Sequence[Arrival] | None = None) -> NetworkRun:
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
            arrival = waiting.pop()
            peer.take(arrival.report, arrival.time)
        found.estimates.append(peer.estimates(float(now)))
        found.times.append(float(now))
    found.cost = wall.process_time() - begun
    found.truths = [simulation.truth(now) for now in found.times]
    return found


def _distances(truth: NDArray[np.float64], found: Sequence[Estimate]) -> NDArray[np.float64]:
    means = np.array([one.mean[:3] for one in found]).reshape(-1, 3)
    return np.linalg.norm(truth[:, None] - means[None], axis=2)
