"""Whether two tracks are one target."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from av_network.hypothesis_filter import LOG_TAU, HypothesisFilter
from av_network.network_target import NetworkTarget
from av_network.settings import NetworkSettings


def are_same(states: HypothesisFilter, hypotheses: Sequence[NetworkTarget], pair: tuple[int, int], settings: NetworkSettings,
             density: float, time: float) -> bool:
    """Whether two tracks are more probably one target than two, of which the other one could be anywhere.

    Those of which a rig observes both are two.

    Parameters:
        states, hypotheses: of the tracker, in the same order.
        pair: their indices.
        settings: of which `most_distance` counts.
        density (1/sr): of targets that are not tracked yet.
        time (s): by the reference clock.
    """
    a, b = (hypotheses[index].members for index in pair)
    if any(abs(a[rig].last - b[rig].last) < 0.5 and time - a[rig].last < 1.0 for rig in a.keys() & b.keys()):
        return False
    mean, P = states.difference(*pair)
    squared = float(mean[:3] @ np.linalg.solve(P[:3, :3], mean[:3]))
    log_density = -0.5 * (squared + 3.0 * LOG_TAU + float(np.linalg.slogdet(P[:3, :3])[1]))
    return log_density > math.log(3.0 * density / settings.most_distance**3)
