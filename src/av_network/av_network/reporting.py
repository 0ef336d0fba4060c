"""What a tracker tells of its targets, and whether their positions are known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.angles import direction_to_angles
from av_network import sphere
from av_network.calibration import RigCalibration
from av_network.hypothesis_filter import HypothesisFilter
from av_network.network_target import SUPPORT_S, WELL_SUPPORTED, NetworkTarget, TargetState
from av_network.settings import NetworkSettings

CONSISTENT = 3.0  # mean normalised innovation squared up to which a position is reported, of up to three rigs
SUPPORTED_S = 3.0  # for which a position is reported that only one rig observes
YOUNG_S = 1.0  # the same, of a track that was only just confirmed
LEAST_VARIANCE = 1e-12  # rad^2, of an error that lasts
RECENT_S = 1.0  # for which a rig's observation counts as recent


def target_states(states: HypothesisFilter, calibration: RigCalibration, hypotheses: Sequence[NetworkTarget],
                  places: Mapping[int, NDArray[np.float64]], settings: NetworkSettings, time: float) -> list[TargetState]:
    """All confirmed targets predicted to a time, by id.

    Parameters:
        states, calibration, hypotheses: of the tracker.
        places: positions (3,) (m) of the rigs by index.
        settings: see `NetworkSettings`.
        time (s): by the reference clock.
    """
    means, covariances = states.predicted(time)
    headings = calibration.heading_variances
    rigs_at = np.array(list(places.values())).reshape(-1, 3)
    found = []
    for index, target in enumerate(hypotheses):
        if not target.confirmed:
            continue
        rigs = tuple(sorted(rig for rig, member in target.members.items() if time - member.last < RECENT_S))
        existence = 0.99 * 0.5 ** (max(time - target.measured, 0.0) / settings.coast)
        mean, P = means[index], covariances[index]
        observing = [rig for rig, member in target.members.items() if time - member.last < SUPPORT_S]
        lasting = states.unstated + np.array([(headings[rig], 0.0) for rig in observing]).reshape(-1, 2)
        P[:3, :3] += lasting_errors(P[:3, :3], mean[:3] - np.array([places[rig] for rig in observing]).reshape(-1, 3), lasting)
        positioned = is_credible(target, time) and is_precise(mean, P, rigs_at, settings)
        found.append(TargetState(target, existence, mean[:6], P[:6, :6], rigs, positioned))
    return sorted(found, key=lambda state: state.target.id)


def lasting_errors(covariance: NDArray[np.float64], offsets: NDArray[np.float64], variances: NDArray[np.float64]
                   ) -> NDArray[np.float64]:
    """Covariance (3, 3) (m^2) of a position by errors of the rigs' directions that last, which no filter averages.

    One direction of each rig with such an error gives it, as far as what is known otherwise does not bound it.

    Parameters:
        covariance (3, 3) (m^2): of the position by errors that are independent.
        offsets (k, 3) (m): from each rig that observes the target; those of a single one tell no position.
        variances (k, 2) (rad^2): of the errors across and up.
    """
    if len(offsets) < 2:
        return np.zeros((3, 3))
    angles = np.stack(direction_to_angles(offsets), -1)
    weights = 1.0 / (np.sum(offsets**2, axis=1)[:, None] * np.maximum(variances, LEAST_VARIANCE))
    axes = sphere.axes(angles)
    return np.asarray(np.linalg.inv(np.linalg.inv(covariance) + np.einsum('ka,kai,kaj->ij', weights, axes, axes)))


def is_credible(target: NetworkTarget, time: float) -> bool:
    """Whether a target's observations fit each other, and are those of two rigs or were so lately.

    One rig alone may meanwhile have a track of another drone. No track is trusted much longer than several rigs have observed
    it: a chance meeting does not last. Each rig beyond three makes one less probable.

    Parameters:
        target: the target.
        time (s): by the reference clock.
    """
    patience = min(SUPPORTED_S, YOUNG_S + target.supported - target.born)
    most = CONSISTENT + max(len(target.tracks(time - SUPPORTED_S)) - WELL_SUPPORTED, 0)
    return target.odds > 0.0 and time - target.supported < patience and target.nis < most


def is_precise(mean: NDArray[np.float64], covariance: NDArray[np.float64], places: NDArray[np.float64],
               settings: NetworkSettings) -> bool:
    """Whether the root mean square error of a position by its covariance is as small as asked.

    Parameters:
        mean (6,), covariance (6, 6): of position (m) and velocity (m/s).
        places (k, 3) (m): of the rigs, one at least.
        settings: `reported_error` and `reported_share`.
    """
    distance = float(np.min(np.linalg.norm(mean[:3] - places, axis=1)))
    most = max(settings.reported_error, settings.reported_share * distance)
    return math.sqrt(max(float(np.trace(covariance[:3, :3])), 0.0)) <= most
