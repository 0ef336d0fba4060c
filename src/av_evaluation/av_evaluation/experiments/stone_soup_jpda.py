"""What trackers of Stone Soup for different states have in common: JPDA's update, and its time."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.functions import gm_reduce_single
from stonesoup.types.array import StateVectors
from stonesoup.types.update import GaussianStateUpdate

START = datetime(2026, 1, 1)
USED = 0.1  # probability of an association from which a detection begins no track


def moment(time: float) -> datetime:
    """A time (s) as Stone Soup has it."""
    return START + timedelta(seconds=time)


def jpda_updates(associations: dict[Any, Any], updater: Any, time: datetime, used: set[Any]) -> Iterator[tuple[Any, Any]]:
    """Tracks with their updates: the hypotheses of each reduced to one Gaussian.

    Parameters:
        associations: hypotheses by track, of a probabilistic data associator.
        updater: of states.
        time: of the detections.
        used: gets the detections that stem from a track.
    """
    for track, hypotheses in associations.items():
        states, weights = [], []
        for hypothesis in hypotheses:
            states.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
            weights.append(hypothesis.probability)
            if hypothesis and hypothesis.probability > USED:
                used.add(hypothesis.measurement)
        mean, covariance = gm_reduce_single(StateVectors([state.state_vector for state in states]),
                                            np.stack([state.covar for state in states], axis=2), np.array(weights, float))
        yield track, GaussianStateUpdate(mean, covariance, hypotheses, time)
