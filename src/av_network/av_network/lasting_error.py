"""Errors of a rig's directions that last: of its heading, of its calibration, of where in a box the target is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network.observation import Observation

LASTING_S = 5.0  # in which such an error falls to 1 / e of itself; 2 and 20 s give the same figures


class LastingError(NamedTuple):
    """What a rig's earlier directions to a target say of the error of the next one.

    Parameters:
        time (s): of the newest direction, by the reference clock.
        heading (rad): the rig's correction of its azimuth.
        mean (2,) (rad): of the error, across and up.
        share (2,): variance of the error over that of an unknown one.
    """

    time: float
    heading: float
    mean: NDArray[np.float64]
    share: NDArray[np.float64]


UNKNOWN = LastingError(0.0, 0.0, np.zeros(2), np.ones(2))


def track_errors(errors: Sequence[LastingError], observations: Sequence[Observation], residuals: NDArray[np.float64],
                 S: NDArray[np.float64]) -> tuple[list[LastingError], NDArray[np.float64]]:
    """Use k innovations; returns the errors, and logarithms (k,) of how much more probable what was known of them makes those.

    Without it, a hypothesis that has errors that last competes with that of another target, whose track has none. Errors fade
    exponentially (Gauss-Markov process), and each axis is on its own.

    Parameters:
        errors (k,): by earlier directions.
        observations (k,): the new directions.
        residuals (k, 2) (rad), S (k, 2, 2) (rad^2): the innovations and their covariances, the errors being unknown.
    """
    before, turned, mean, share = (np.array(part) for part in zip(*errors, strict=True))
    times, headings, levels = np.array([(one.time, one.known.heading, one.level) for one in observations]).T
    variances = np.array([one.lasting for one in observations])
    mean[:, 0] += (1.0 - share[:, 0]) * (headings - turned) * levels
    kept = np.exp(-np.abs(times - before) / LASTING_S)[:, None]
    mean, share = kept * mean, 1.0 - kept**2 * (1.0 - share)
    unknown = np.diagonal(S, axis1=1, axis2=2)
    known = unknown - (1.0 - share) * variances
    gains = -0.5 * np.sum((residuals - mean)**2 / known + np.log(known) - residuals**2 / unknown - np.log(unknown), axis=1)
    weights = share * variances / known
    mean, share = mean + weights * (residuals - mean), (1.0 - weights) * share
    return [LastingError(*each) for each in zip(times.tolist(), headings.tolist(), mean, share, strict=True)], gains
