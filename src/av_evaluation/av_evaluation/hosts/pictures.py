"""What the network nodes of several hosts have shown, against the truth and against each other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from av_evaluation.network.figures import STEP_S, Estimate, NetworkRun, agree, lost_tracks, partition_figures
from av_evaluation.network.simulation import NetworkSimulation

STALE_S = 1.0  # age of the newest picture from which a node has none


class Picture(NamedTuple):
    """The targets with positions that a node has at a time (s): id, position (m) and velocity (m/s) of each."""

    time: float
    targets: Sequence[Sequence[float]]


class Phase(NamedTuple):
    """Drones without a position, positions of no drone (means over time), and the error (m) of the others."""

    missed: float
    false: float
    error: float


class Agreement(NamedTuple):
    """What a partition did to the pictures of all nodes.

    Parameters:
        lost: number of tracks that it lost.
        first, healed (s): time from its end until all nodes have one picture, and until they have it for good; inf if never.
        apart: share of the time after it in which they do not.
    """

    lost: int
    first: float
    healed: float
    apart: float


def run_of(pictures: Iterable[Picture], simulation: NetworkSimulation) -> NetworkRun:
    """The run of a node: what it shows at each step, moved on by its velocities to that time.

    Parameters:
        pictures: in order of time, which begins with that of the simulation.
        simulation: the truth.
    """
    found, waiting = NetworkRun(), sorted(pictures, key=lambda each: each.time, reverse=True)
    newest = Picture(-math.inf, ())
    for now in np.arange(STEP_S, simulation.duration, STEP_S):
        while waiting and waiting[-1].time <= now:
            newest = waiting.pop()
        age = float(now) - newest.time
        found.times.append(float(now))
        found.estimates.append([_estimate(target, age) for target in newest.targets] if age < STALE_S else [])
        found.truths.append(simulation.truth(float(now)))
    return found


def _estimate(target: Sequence[float], age: float) -> Estimate:
    position, velocity = np.array(target[1:4]), np.array(target[4:7])
    return Estimate(int(target[0]), np.concatenate([position + age * velocity, velocity]), np.eye(6))


def phase(run: NetworkRun, begin: float, end: float) -> Phase:
    """Figures of a part of a run.

    Parameters:
        run: of a node.
        begin, end (s): of the part.
    """
    first, last = (int(np.searchsorted(run.times, moment)) for moment in (begin, end))
    part = NetworkRun(run.times[first:last], run.truths[first:last], run.estimates[first:last])
    _, missed, false = part.gospa()
    return Phase(missed, false, part.rmse())


def agreement(runs: Sequence[NetworkRun], begin: float, end: float) -> Agreement:
    """Compare the pictures of all nodes.

    Parameters:
        runs: of the nodes.
        begin, end (s): of the partition.
    """
    after = [step for step, time in enumerate(runs[0].times) if time >= end]
    alike = [all(agree(one.estimates[step], other.estimates[step]) for one, other in combinations(runs, 2)) for step in after]
    first = next((runs[0].times[step] - end for step, same in zip(after, alike, strict=True) if same), math.inf)
    healed = max(partition_figures(one, other, begin, end).healed for one, other in combinations(runs, 2))
    return Agreement(sum(lost_tracks(each, begin, end) for each in runs), first, healed, 1.0 - float(np.mean(alike)))
