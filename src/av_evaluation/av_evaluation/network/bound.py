"""The Cramer-Rao bound of a position from the directions that rigs report at one time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from av_evaluation.network.simulation import Arrival, NetworkSimulation
from av_network.report import Report


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
    squared = []
    for arrival in arrivals:
        if arrival.report.sightings:
            latest[arrival.report.rig] = arrival.report
        if arrival.time >= after and len(latest) == len(simulation.rigs):
            squared.append(position_bound(simulation.truth(arrival.time)[0], latest.values()) ** 2)
    return math.sqrt(float(np.mean(squared)))
