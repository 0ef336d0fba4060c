"""Whether the standard deviations of a track are as large as its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from av_common.track import State
from av_evaluation.metrics.results import RunResult

INTERVAL = 1.64  # standard deviations, which hold 90 % of Gaussian errors
LEADING = {State.VISUAL_ACTIVE: 'sight', State.ACOUSTIC_ACTIVE: 'sound'}
SAME_S = 1e-6  # difference of the times of one bearing


@dataclass(frozen=True)
class SigmaFigures:
    """Errors and standard deviations while one sensor leads.

    Parameters:
        within: share of errors within INTERVAL standard deviations, 0.9 by definition.
        rmse_deg, sigma_deg (degrees): root mean square of the errors and of the standard deviations.
    """

    within: float
    rmse_deg: float
    sigma_deg: float


def sigma_by_sensor(runs: Sequence[RunResult]) -> dict[str, SigmaFigures]:
    """Figures of the fused track over all runs by the sensor that leads; without sensors that never do."""
    errors: dict[str, list[float]] = {name: [] for name in LEADING.values()}
    sigmas: dict[str, list[float]] = {name: [] for name in LEADING.values()}
    for run in runs:
        if 'fused' not in run.methods or not len(run.state['time']):
            continue
        track, fused = run.state, run.methods['fused']
        row = np.minimum(np.searchsorted(track['time'], fused.error_time - SAME_S), len(track['time']) - 1)
        for state, name in LEADING.items():
            led = (np.abs(track['time'][row] - fused.error_time) < SAME_S) & (track['state'][row] == state)
            errors[name] += np.abs(fused.error_deg[led]).tolist()
            sigmas[name] += np.degrees(track['sigma'][row[led]]).tolist()
    return {name: SigmaFigures(float(np.mean(np.array(errors[name]) < INTERVAL * np.array(sigmas[name]))),
                               *(float(np.sqrt(np.mean(np.square(values)))) for values in (errors[name], sigmas[name])))
            for name in errors if errors[name]}
