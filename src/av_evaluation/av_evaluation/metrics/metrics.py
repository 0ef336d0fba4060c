"""Figures of a run: coverage, errors and their interval, time to resolve front and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.metrics.run_log import RunLog, Series

GRID_HZ = 20.0  # the rate of fusion
VALID_S = 0.25  # a bearing counts this long for coverage
OUTLIER_DEG = 20.0  # beyond which a bearing is wrong
TAU = 0.5  # score from which a detection counts
BLOCK_S = 2.0  # errors of successive windows are correlated: resampling them singly gives too short an interval
INTERVAL = 1.64  # standard deviations, within which are 90 % of Gaussian errors
LEVEL, RESAMPLES = 0.95, 2000  # of the interval: its probability, and the number of bootstrap samples


def acquired(log: RunLog) -> float:
    """Time (s) from which errors count: the arrival of the first detection, nan without bearings.

    Without a detection it is that of the first bearing with resolved front and back, else of the first bearing.
    """
    detected = log.sight['score'] >= TAU
    tracked = log.fused['state'] != State.NONE
    resolved = tracked & (log.fused['resolved'] > 0.0)
    candidates = ((log.sight['time'] + log.sight['delay'])[detected], log.fused['time'][resolved], log.fused['time'][tracked])
    return next((float(times.min()) for times in candidates if times.size), math.nan)


def compare(time: NDArray, azimuth: NDArray, log: RunLog, acquired: float) -> tuple[NDArray, NDArray, NDArray]:
    """Compare bearings with the truth, where there is one: times (n, s), signed errors (n, degrees), and confusions (n,).

    A bearing confuses front and back where it is on the other side of the axis between them than the target.

    Parameters:
        time (n, s): of the bearings.
        azimuth (n, rad): in the body frame.
        log: with the truth.
        acquired (s): earlier bearings are left out.
    """
    truth = log.true_azimuth(time)
    error = np.degrees(wrap(azimuth - truth))
    counted = np.isfinite(error) & (time >= acquired)
    opposite = np.cos(truth) * np.cos(azimuth) < 0.0
    return time[counted], error[counted], opposite[counted]


def held_errors(arrival: NDArray, time: NDArray, azimuth: NDArray, outputs: NDArray, log: RunLog) -> NDArray[np.float64]:
    """Signed errors (m, degrees) of the newest measurement at the times of outputs; its direction in the world is held.

    Parameters:
        arrival (n, s): of the measurements.
        time (n, s): of their capture.
        azimuth (n, rad): in the body frame at capture.
        outputs (k, s): instants; those before the first arrival, and those without a truth, are left out.
        log: with the truth and the rig's heading.
    """
    order = np.argsort(arrival, kind='stable')
    newest = np.searchsorted(arrival[order], outputs, side='right') - 1
    outputs, newest = outputs[newest >= 0], order[newest[newest >= 0]]
    world = azimuth[newest] + log.heading(time[newest])
    error: NDArray[np.float64] = np.degrees(wrap(world - log.heading(outputs) - log.true_azimuth(outputs)))
    return error[np.isfinite(error)]


def errors_of(error_deg: NDArray, opposite: NDArray) -> dict[str, float]:
    """Figures of a series of errors: angles in degrees, shares from 0 to 1; nan without errors.

    Parameters:
        error_deg (n, degrees): signed errors.
        opposite (m,): whether front and back are confused; empty where that is not defined.
    """
    error = np.abs(error_deg) if len(error_deg) else np.array([math.nan])
    return {'rmse_deg': rmse(error), 'mae_deg': float(np.mean(error)),
            'median_deg': float(np.median(error)), 'p95_deg': float(np.percentile(error, 95)),
            'outliers': float(np.mean(error > OUTLIER_DEG)) if len(error_deg) else math.nan,
            'hemisphere_errors': float(np.mean(opposite)) if len(opposite) and len(error_deg) else math.nan}


def coverage_of(begin: float, span: float, reports: NDArray[np.float64]) -> float:
    """Share of instants with a bearing no older than VALID_S; nan without instants.

    Parameters:
        begin, span (s): of the time that counts.
        reports (m, s): times of the bearings.
    """
    if not span > 0.0:
        return math.nan
    if not reports.size:
        return 0.0
    grid = np.arange(begin, begin + span, 1.0 / GRID_HZ)
    newest = np.searchsorted(np.sort(reports), grid + 1.0 / GRID_HZ) - 1
    age = np.where(newest >= 0, grid - np.sort(reports)[np.maximum(newest, 0)], np.inf)
    return float(np.mean(age <= VALID_S))


def time_to_resolve(log: RunLog, track: Series) -> float:
    """Time (s) from the first measurement of sound, or bearing, to the first resolved bearing; nan where there is none.

    Resolved bearings that are wrong by more than 20 degrees do not count.

    Parameters:
        log: of the run.
        track: bearings, like `RunLog.fused`.
    """
    time, resolved = track['time'], track['resolved'] > 0.0
    if not len(time):
        return math.nan
    wrong = np.abs(wrap(track['azimuth'] - log.true_azimuth(time))) > math.radians(OUTLIER_DEG)
    right = time[resolved & ~wrong]
    reported = np.concatenate([log.sound['time'][log.sound['confidence'] > 0.0], time[track['state'] != State.NONE]])
    return float(max(right[0] - reported.min(), 0.0)) if right.size and reported.size else math.nan


def rmse(errors: ArrayLike) -> float:
    """Root of the mean square of errors (n,); NaN of none."""
    return float(np.sqrt(np.mean(np.square(errors)))) if np.size(errors) else math.nan


def blocks_of(time: NDArray, values: NDArray) -> list[NDArray]:
    """Cut a series into blocks of BLOCK_S for `rmse_interval`.

    Parameters:
        time (n, s): increasing.
        values (n,): at these times.
    """
    if not len(time):
        return []
    cuts = np.flatnonzero(np.diff(np.floor((time - time[0]) / BLOCK_S))) + 1
    return np.split(values, cuts)


def rmse_interval(blocks: Sequence[NDArray]) -> tuple[float, float]:
    """Confidence interval of the RMSE by the block bootstrap (Kuensch, 1989), percentile method; nan for fewer than two blocks.

    Blocks of one value each make the ordinary bootstrap (Efron, 1979).

    Parameters:
        blocks: of errors, each drawn as a whole with replacement.
    """
    if len(blocks) < 2:
        return math.nan, math.nan
    sums = [np.sum(np.square(block)) for block in blocks], [len(block) for block in blocks]
    low, high = stats.bootstrap(
        sums, lambda squares, counts, axis: np.sqrt(squares.sum(axis) / counts.sum(axis)), paired=True, method='percentile',
        confidence_level=LEVEL, n_resamples=RESAMPLES, random_state=1).confidence_interval
    return float(low), float(high)
