"""Two nodes of one network that is parted for a while: what each keeps, and when they agree again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from av_evaluation.metrics.gospa import gospa
from av_evaluation.network.figures import CUTOFF_M, Estimate, NetworkRun

AGREE_M = 5.0  # GOSPA between the pictures of two nodes, up to which they are the same


class PartitionFigures(NamedTuple):
    """What a partition does.

    Parameters:
        lost: number of tracks of either node that had existed before the partition and do not after it.
        missed: share of drones without a track during the partition, the mean of both nodes.
        healed (s): time from the end of the partition until both nodes have the same picture, for good; inf if never.
    """

    lost: int
    missed: float
    healed: float


def partition_figures(first: NetworkRun, second: NetworkRun, begin: float, end: float) -> PartitionFigures:
    """Figures of two nodes' runs.

    Parameters:
        first, second: with the same times.
        begin, end (s): of the partition.
    """
    times = np.array(first.times)
    before, after = (int(np.searchsorted(times, moment)) for moment in (begin, end))
    missed = []
    for each in (first, second):
        missed += [1.0 - min(len(found), len(true)) / len(true) for found, true in
                   zip(each.estimates[before:after], each.truths[before:after], strict=True)]
    apart = [time for time, one, other in zip(times[after:], first.estimates[after:], second.estimates[after:], strict=True)
             if not agree(one, other)]
    healed = max(apart[-1] - end, 0.0) if apart else 0.0
    if apart and apart[-1] == times[-1]:
        healed = math.inf
    lost = lost_tracks(first, begin, end) + lost_tracks(second, begin, end)
    return PartitionFigures(lost, float(np.mean(missed)), float(healed))


def lost_tracks(run: NetworkRun, begin: float, end: float) -> int:
    """Number of tracks that existed before a partition and do not in the 2 s after it.

    Parameters:
        run: of a node.
        begin, end (s): of the partition.
    """
    before, after = (int(np.searchsorted(run.times, moment)) for moment in (begin, end))
    names = [{one.id for one in found} for found in run.estimates]
    return len(names[before] - set().union(*names[after:after + 20]))


def agree(first: Sequence[Estimate], second: Sequence[Estimate]) -> bool:
    """Whether two pictures are the same: GOSPA between them, with cut-off CUTOFF_M, of up to AGREE_M.

    A target that only one of them has makes it CUTOFF_M / sqrt(2), which is more; the sum of the squared distances of the
    others is AGREE_M^2 at most.
    """
    one, other = (np.array([each.mean[:3] for each in found]).reshape(-1, 3) for found in (first, second))
    return gospa(np.linalg.norm(one[:, None] - other[None], axis=2), CUTOFF_M).distance <= AGREE_M
