"""What a tracker tells of its targets, and whether their positions are known."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_network.hypothesis_filter import HypothesisFilter
from av_network.motion_model import nearly_constant_velocity
from av_network.network_target import NetworkTarget, TargetState
from av_network.settings import NetworkSettings

CONSISTENT = 3.0  # mean normalised innovation squared up to which a position is reported
SUPPORTED_S = 1.5  # for which a position is reported that only one rig observes
RECENT_S = 1.0  # for which a rig's observation counts as recent


def target_states(states: HypothesisFilter, hypotheses: Sequence[NetworkTarget], places: Sequence[NDArray[np.float64]],
                  settings: NetworkSettings, time: float) -> list[TargetState]:
    """All confirmed targets predicted to a time, by id.

    Parameters:
        states, hypotheses: of the tracker, in the same order.
        places: positions (3,) (m) of the rigs.
        settings: see `NetworkSettings`.
        time (s): by the reference clock.
    """
    means, covariances = states.targets()
    step = 0.0 if states.time is None else time - states.time
    F, Q = (np.kron(part, np.eye(3)) for part in nearly_constant_velocity(step, settings.manoeuvre))
    found = []
    for index, target in enumerate(hypotheses):
        if not target.confirmed:
            continue
        rigs = tuple(sorted(rig for rig, member in target.members.items() if time - member.last < RECENT_S))
        existence = 0.99 * 0.5 ** (max(time - target.measured, 0.0) / settings.coast)
        mean, P = F @ means[index], F @ covariances[index] @ F.T + Q
        verified = target.odds > 0.0 and time - target.supported < SUPPORTED_S
        positioned = target.nis < CONSISTENT and verified and is_precise(mean, P, places, settings)
        found.append(TargetState(target, existence, mean, P, rigs, positioned))
    return sorted(found, key=lambda state: state.target.id)


def is_precise(mean: NDArray[np.float64], covariance: NDArray[np.float64], places: Sequence[NDArray[np.float64]],
               settings: NetworkSettings) -> bool:
    """Whether the root mean square error of a position by its covariance is as small as asked.

    Parameters:
        mean (6,), covariance (6, 6): of position (m) and velocity (m/s).
        places: positions (3,) (m) of the rigs.
        settings: `reported_error` and `reported_share`.
    """
    distance = min((float(np.linalg.norm(mean[:3] - place)) for place in places), default=0.0)
    most = max(settings.reported_error, settings.reported_share * distance)
    return math.sqrt(max(float(np.trace(covariance[:3, :3])), 0.0)) <= most
