"""Figures of a run: coverage, errors, how soon front and back were told apart, switches, rates and delays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.metrics.run_log import RunLog, Series

GRID_HZ = 20.0
FRESH_S = 0.25  # a report counts this long for coverage
OUTLIER_DEG = 20.0


@dataclass(frozen=True)
class Errors:
    """Of one sense or method. Angles in degrees; shares 0..1; nan where there is no truth."""

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
    """Figures of a run, for `fused`, `sound` (the nearer of its mirror images) and `sight`."""

    senses: dict[str, Errors]
    acquired: float = math.nan
    time_to_resolve: float = math.nan
    switches: int = 0
    notes: dict[str, str] = field(default_factory=dict)


def summarise(log: RunLog, tau: float = 0.5) -> Summary:
    """Compute the figures.

    They count from the arrival of the first detection on; where nothing was seen from the first bearing whose hemisphere
    was declared, else from the first bearing.
    """
    seen = log.sight['confidence'] >= tau
    following = log.fused['state'] != State.NONE
    heard = log.sound['confidence'] > 0.0
    declared = following & (log.fused['resolved'] > 0.0)
    beginnings = ((log.sight['time'] + log.sight['delay'])[seen], log.fused['time'][declared], log.fused['time'][following])
    acquired = next((float(times.min()) for times in beginnings if times.size), math.nan)
    end = max((float(series['time'].max()) for series in (log.fused, log.sound, log.sight) if len(series)), default=0.0)
    sound = np.stack([log.sound['azimuth'], log.sound['mirrored']])[:, heard]
    senses = {'fused': figures_of(log.fused['time'][following], log.fused['azimuth'][following], log, acquired, end),
              'sound': figures_of(log.sound['time'][heard], sound, log, acquired, end),
              'sight': figures_of(log.sight['time'][seen], log.sight['azimuth'][seen], log, acquired, end)}
    timed = {name: _with_timing(errors, getattr(log, name)) for name, errors in senses.items()}
    return Summary(timed, acquired, time_to_resolve(log), switches(log.fused), dict(log.notes))


def figures_of(time: NDArray, azimuth: NDArray, log: RunLog, acquired: float, end: float) -> Errors:
    """Figures of body azimuths (n,) in rad at times (n,) in s, from `acquired` to `end`.

    Azimuths (2, n) are mirror images, of which the nearer to the truth counts (nan: there is none).
    """
    judged = judge(time, azimuth, log, acquired)
    grid = np.arange(acquired, end, 1.0 / GRID_HZ) if math.isfinite(acquired) else np.empty(0)
    return errors_of(judged.error_deg, judged.opposite, coverage_of(grid, time))


@dataclass(frozen=True)
class Judged:
    """Bearings beside the truth (n,): times in s, signed errors in degrees, and whether front and back are confused."""

    time: NDArray[np.float64]
    error_deg: NDArray[np.float64]
    opposite: NDArray[np.bool_]


def judge(time: NDArray, azimuth: NDArray, log: RunLog, acquired: float = -math.inf) -> Judged:
    """Compare body azimuths (n,), or mirror images (2, n), with the truth, from `acquired` on and where there is truth."""
    images, truth = np.atleast_2d(azimuth), log.true_azimuth(time)
    apart = wrap(np.nan_to_num(images) - truth)
    apart[np.isnan(images)] = np.nan
    chosen = np.argmin(np.abs(np.nan_to_num(apart, nan=np.inf)), axis=0) if time.size else np.zeros(0, int)
    error = np.degrees(np.take_along_axis(apart, chosen[np.newaxis], axis=0)[0])
    counted = np.isfinite(error) & (time >= acquired)
    opposite = np.cos(truth) * np.cos(images[0]) < 0.0 if len(images) == 1 else np.zeros(len(time), bool)
    return Judged(time[counted], error[counted], opposite[counted])


def errors_of(error_deg: NDArray, opposite: NDArray, coverage: float) -> Errors:
    """Figures of signed errors (n,) in degrees."""
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


def coverage_of(grid: NDArray[np.float64], reports: NDArray[np.float64]) -> float:
    """Share of the instants of `grid` (s) with a report no older than FRESH_S."""
    if not grid.size:
        return math.nan
    if not reports.size:
        return 0.0
    newest = np.searchsorted(np.sort(reports), grid + 1.0 / GRID_HZ) - 1
    age = np.where(newest >= 0, grid - np.sort(reports)[np.maximum(newest, 0)], np.inf)
    return float(np.mean(age <= FRESH_S))


def time_to_resolve(log: RunLog, track: Series | None = None) -> float:
    """Seconds from the first sound or bearing to the first bearing of a track (the log's own) that is resolved.

    Where there is truth, rightly so.
    """
    track = log.fused if track is None else track
    time, resolved = track['time'], track['resolved'] > 0.0
    if not len(time):
        return math.nan
    wrong = np.abs(wrap(track['azimuth'] - log.true_azimuth(time))) > math.radians(OUTLIER_DEG)
    right = time[resolved & ~wrong]
    heard = np.concatenate([log.sound['time'][log.sound['confidence'] > 0.0], time[track['state'] != State.NONE]])
    return float(max(right[0] - heard.min(), 0.0)) if right.size and heard.size else math.nan


def switches(track: Series) -> int:
    """How often the leading sense changed between sight and sound."""
    state = track['state']
    leading = state[(state == State.VISUAL_ACTIVE) | (state == State.ACOUSTIC_ACTIVE)]
    return int(np.count_nonzero(np.diff(leading)))
