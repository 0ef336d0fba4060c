"""What a tracker tells of its targets, and whether their positions are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.angles import direction_to_angles
from av_network import sphere
from av_network.apparent_direction import LEAST_DISTANCE_M
from av_network.calibration import LEAST_SIGMA, RigCalibration
from av_network.hypothesis_filter import HypothesisFilter
from av_network.network_target import SUPPORT_S, WELL_SUPPORTED, NetworkTarget, TargetState

REPORTED_ERROR_M = 7.0  # root mean square error of a position, by its covariance, up to which it is reported as one
REPORTED_SHARE = 0.1  # of the distance from the nearest rig, up to which that error may grow
COAST_S = 8.0  # after which a track without reports has lost half of its probability of existence, and ends
CONSISTENT = 3.0  # mean normalised innovation squared up to which a position is reported, of up to three rigs
SUPPORTED_S = 4.0  # since the newest observation of a second rig, for which a position is reported


def target_states(states: HypothesisFilter, calibration: RigCalibration, hypotheses: Sequence[NetworkTarget],
                  places: Mapping[int, NDArray[np.float64]], time: float) -> list[TargetState]:
    """All confirmed targets predicted to a time, by id.

    Parameters:
        states, calibration, hypotheses: of the tracker.
        places: positions (3,) (m) of the rigs by index.
        time (s): by the reference clock.
    """
    rows = [row for row, target in enumerate(hypotheses) if target.confirmed]
    if not rows:
        return []
    means, covariances = (part[rows] for part in states.predicted(time))
    targets = [hypotheses[row] for row in rows]
    observing = np.array([[rig in target.members and time - target.members[rig].last < SUPPORT_S for rig in places]
                          for target in targets])
    offsets = means[:, None, :3] - np.array(list(places.values()))
    headings = [calibration.known(rig).heading_sigma ** 2 for rig in places]
    variances = states.unstated + np.stack([headings, np.zeros(len(places))], 1)
    covariances[:, :3, :3] += lasting_errors(covariances[:, :3, :3], offsets, variances, observing)
    nearest, errors = np.linalg.norm(offsets, axis=2).min(axis=1), np.trace(covariances[:, :3, :3], axis1=1, axis2=2)
    precise = errors <= np.maximum(REPORTED_ERROR_M, REPORTED_SHARE * nearest) ** 2
    found = []
    for row, target in enumerate(targets):
        rigs = tuple(sorted(rig for rig, member in target.members.items() if time - member.last < SUPPORT_S))
        existence = 0.99 * 0.5 ** (max(time - target.measured, 0.0) / COAST_S)
        found.append(TargetState(target, existence, means[row, :6], covariances[row, :6, :6], rigs,
                                 bool(precise[row]) and is_credible(target, time)))
    return sorted(found, key=lambda state: state.target.id)


def lasting_errors(covariances: NDArray[np.float64], offsets: NDArray[np.float64], variances: NDArray[np.float64],
                   observing: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Covariances (n, 3, 3) (m^2) of positions by errors of the rigs' directions that last, which no filter averages.

    One direction of each rig with such an error gives it, as far as what is known otherwise does not bound it.

    Parameters:
        covariances (n, 3, 3) (m^2): of the positions by errors that are independent.
        offsets (n, r, 3) (m): from each rig.
        variances (r, 2) (rad^2): of the errors of each across and up.
        observing (n, r): which rigs observe the targets; a single one tells no position.
    """
    axes = sphere.axes(np.stack(direction_to_angles(offsets), -1))
    squared = np.maximum(np.sum(offsets**2, axis=2), LEAST_DISTANCE_M**2)
    weights = observing[:, :, None] / (squared[:, :, None] * np.maximum(variances, LEAST_SIGMA**2))
    information = np.einsum('nra,nrai,nraj->nij', weights, axes, axes)
    several = np.sum(observing, axis=1) > 1
    return np.asarray(several[:, None, None] * np.linalg.inv(np.linalg.inv(covariances) + information))


def is_credible(target: NetworkTarget, time: float) -> bool:
    """Whether a target's observations fit each other, and are those of two rigs or were so lately.

    One rig alone may meanwhile have a track of another drone. Each rig beyond three makes a chance meeting less probable.

    Parameters:
        target: the target.
        time (s): by the reference clock.
    """
    observing = len(target.tracks(time - SUPPORTED_S))
    return target.odds > 0.0 and observing > 1 and target.nis < CONSISTENT + max(observing - WELL_SUPPORTED, 0)
