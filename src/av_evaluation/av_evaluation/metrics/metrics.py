"""Figures of a run: coverage, errors, time to resolve front and back, switches, rates and delays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.metrics.run_log import RunLog, Series

GRID_HZ = 20.0
VALID_S = 0.25  # a bearing counts this long for coverage
OUTLIER_DEG = 20.0
TAU = 0.5  # score from which a detection counts


@dataclass(frozen=True)
class Errors:
    """Figures of one series of bearings. Angles in degrees, shares from 0 to 1; nan without truth.

    Attributes:
        coverage: share of the time with a valid bearing.
        rmse_deg: root of the mean square error.
        mae_deg: mean absolute error.
        median_deg: median of the absolute errors.
        p95_deg: 95th percentile of the absolute errors.
        outliers: share of errors beyond 20 degrees.
        hemisphere_errors: share of bearings in front for a target behind, or the reverse.
        rate_hz: of bearings.
        delay_median_ms: median of the delays.
        delay_p95_ms: 95th percentile of the delays.
    """

    coverage: float = math.nan
    rmse_deg: float = math.nan
    mae_deg: float = math.nan
    median_deg: float = math.nan
    p95_deg: float = math.nan
    outliers: float = math.nan
    hemisphere_errors: float = math.nan
    rate_hz: float = 0.0
    delay_median_ms: float = math.nan
    delay_p95_ms: float = math.nan


@dataclass(frozen=True)
class Summary:
    """Figures of a run.

    Attributes:
        senses: of `fused`, `sound` (the hypothesis nearer to the truth) and `sight`.
        acquired (s): time from which errors count, nan without bearings.
        time_to_resolve (s): see the function of this name.
        switches: see the function of this name.
        notes: on the origin of the data.
    """

    senses: dict[str, Errors]
    acquired: float = math.nan
    time_to_resolve: float = math.nan
    switches: int = 0
    notes: dict[str, str] = field(default_factory=dict)


def summarise(log: RunLog) -> Summary:
    """Compute the figures of a run.

    Errors count from the arrival of the first detection. Without one they count from the first bearing with resolved front
    and back, else from the first bearing.
    """
    detected = log.sight['score'] >= TAU
    tracked = log.fused['state'] != State.NONE
    valid = log.sound['confidence'] > 0.0
    resolved = tracked & (log.fused['resolved'] > 0.0)
    candidates = ((log.sight['time'] + log.sight['delay'])[detected], log.fused['time'][resolved], log.fused['time'][tracked])
    acquired = next((float(times.min()) for times in candidates if times.size), math.nan)
    end = max((float(series['time'].max()) for series in (log.fused, log.sound, log.sight) if len(series)), default=0.0)
    sound = np.stack([log.sound['azimuth'], log.sound['mirrored']])[:, valid]
    senses = {'fused': figures_of(log.fused['time'][tracked], log.fused['azimuth'][tracked], log, acquired, end),
              'sound': figures_of(log.sound['time'][valid], sound, log, acquired, end),
              'sight': figures_of(log.sight['time'][detected], log.sight['azimuth'][detected], log, acquired, end)}
    timed = {name: _with_timing(errors, getattr(log, name)) for name, errors in senses.items()}
    return Summary(timed, acquired, time_to_resolve(log), switches(log.fused), dict(log.notes))


def figures_of(time: NDArray, azimuth: NDArray, log: RunLog, acquired: float, end: float) -> Errors:
    """Figures of a series of bearings.

    Parameters:
        time (n, s): of the bearings.
        azimuth (n, rad) or (2, n, rad): in the body frame. Of two hypotheses the one nearer to the truth counts; nan is none.
        log: with the truth.
        acquired (s): from which errors and coverage count.
        end (s): of the time that counts for coverage.
    """
    compared = compare(time, azimuth, log, acquired)
    grid = instants(acquired, end) if math.isfinite(acquired) else np.zeros(0)
    return errors_of(compared.error_deg, compared.opposite, coverage_of(grid, time))


@dataclass(frozen=True)
class Comparison:
    """Bearings compared with the truth.

    Attributes:
        time (n, s): of the bearings.
        error_deg (n, degrees): signed errors.
        opposite (n,): whether front and back are confused.
    """

    time: NDArray[np.float64]
    error_deg: NDArray[np.float64]
    opposite: NDArray[np.bool_]


def compare(time: NDArray, azimuth: NDArray, log: RunLog, acquired: float = -math.inf) -> Comparison:
    """Compare bearings with the truth, where there is one.

    Parameters:
        time (n, s): of the bearings.
        azimuth (n, rad) or (2, n, rad): in the body frame. Of two hypotheses the one nearer to the truth counts; nan is none.
        log: with the truth.
        acquired (s): earlier bearings are left out.
    """
    hypotheses, truth = np.atleast_2d(azimuth), log.true_azimuth(time)
    errors = wrap(np.nan_to_num(hypotheses) - truth)
    errors[np.isnan(hypotheses)] = np.nan
    chosen = np.argmin(np.abs(np.nan_to_num(errors, nan=np.inf)), axis=0) if time.size else np.zeros(0, int)
    error = np.degrees(np.take_along_axis(errors, chosen[np.newaxis], axis=0)[0])
    counted = np.isfinite(error) & (time >= acquired)
    opposite = np.cos(truth) * np.cos(hypotheses[0]) < 0.0 if len(hypotheses) == 1 else np.zeros(len(time), bool)
    return Comparison(time[counted], error[counted], opposite[counted])


def errors_of(error_deg: NDArray, opposite: NDArray, coverage: float) -> Errors:
    """Figures of a series of errors, without rate and delays.

    Parameters:
        error_deg (n, degrees): signed errors.
        opposite (m,): whether front and back are confused; empty where that is not defined.
        coverage: share of the time with a valid bearing.
    """
    error = np.abs(error_deg)
    if not error.size:
        return Errors(coverage)
    return Errors(coverage, float(np.sqrt(np.mean(error**2))), float(np.mean(error)), float(np.median(error)),
                  float(np.percentile(error, 95)), float(np.mean(error > OUTLIER_DEG)),
                  float(np.mean(opposite)) if len(opposite) else math.nan)


def _with_timing(errors: Errors, series: Series) -> Errors:
    time, delay = series['time'], 1e3 * series['delay'][np.isfinite(series['delay'])]
    rate = float((len(time) - 1) / max(np.ptp(time), 1e-9)) if len(time) > 1 else 0.0
    if not delay.size:
        return replace(errors, rate_hz=rate)
    return replace(errors, rate_hz=rate, delay_median_ms=float(np.median(delay)), delay_p95_ms=float(np.percentile(delay, 95)))


def instants(begin: float, end: float) -> NDArray[np.float64]:
    """Instants (n, s) between two times (s) at which coverage is evaluated."""
    return np.arange(begin, end, 1.0 / GRID_HZ).astype(np.float64)


def coverage_of(grid: NDArray[np.float64], reports: NDArray[np.float64]) -> float:
    """Share of instants with a bearing no older than VALID_S; nan without instants.

    Parameters:
        grid (n, s): instants.
        reports (m, s): times of the bearings.
    """
    if not grid.size:
        return math.nan
    if not reports.size:
        return 0.0
    newest = np.searchsorted(np.sort(reports), grid + 1.0 / GRID_HZ) - 1
    age = np.where(newest >= 0, grid - np.sort(reports)[np.maximum(newest, 0)], np.inf)
    return float(np.mean(age <= VALID_S))


def time_to_resolve(log: RunLog, track: Series | None = None) -> float:
    """Time (s) from the first measurement of sound, or bearing, to the first resolved bearing; nan where there is none.

    Resolved bearings that are wrong by more than 20 degrees do not count.

    Parameters:
        log: of the run.
        track: bearings, like `RunLog.fused`; the log's own where None.
    """
    track = log.fused if track is None else track
    time, resolved = track['time'], track['resolved'] > 0.0
    if not len(time):
        return math.nan
    wrong = np.abs(wrap(track['azimuth'] - log.true_azimuth(time))) > math.radians(OUTLIER_DEG)
    right = time[resolved & ~wrong]
    reported = np.concatenate([log.sound['time'][log.sound['confidence'] > 0.0], time[track['state'] != State.NONE]])
    return float(max(right[0] - reported.min(), 0.0)) if right.size and reported.size else math.nan


def switches(track: Series) -> int:
    """Number of changes of a track between `VISUAL_ACTIVE` and `ACOUSTIC_ACTIVE`."""
    state = track['state']
    leading = state[(state == State.VISUAL_ACTIVE) | (state == State.ACOUSTIC_ACTIVE)]
    return int(np.count_nonzero(np.diff(leading)))
