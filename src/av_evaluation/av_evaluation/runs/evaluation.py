"""From the log of a run to its figures: of every method, for all programs and the monitor."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from av_common.track import State
from av_evaluation.experiments.methods import UnavailableError, bearings, is_folded, is_tracker, track
from av_evaluation.metrics.metrics import INTERVAL, acquired, compare, coverage_of, held_errors, time_to_resolve
from av_evaluation.metrics.results import MethodResult, RunResult, metrics_of, write_json
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.report.text import format_rows, rows_of

SENSES = ('fused', 'sound', 'sight')  # which need no events


def describe(log: RunLog, folder: Path | None) -> str:
    """The table of what a run published, without a filter; a folder also gets metrics.json and the chart bearing.png."""
    result = evaluate_run('', log, SENSES, filtered=False)
    metrics = metrics_of([result])
    if folder is not None:
        from av_evaluation.report.charts import bearing_chart  # matplotlib takes a second to load: not at a node's start

        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / 'metrics.json', metrics)
        bearing_chart(result).savefig(folder / 'bearing.png', dpi=110)
    first, others = rows_of(metrics)
    head, *rows = zip(first, *others, strict=True)  # a row for each figure fits into a terminal
    return '\n'.join([format_rows(head, rows), *result.notes])


def evaluate_run(name: str, log: RunLog, methods: tuple[str, ...], filtered: bool = True) -> RunResult:
    """Evaluate methods on one run.

    Parameters:
        name: of the run.
        log: truth, measurements and bearings.
        methods: to evaluate.
        filtered: whether bearings pass the median filter of the publication's comparison.
    """
    begin = acquired(log)
    ends = [float(series['time'].max()) for series in (log.fused, log.sound, log.sight) if len(series)]
    span = max(ends, default=0.0) - begin if math.isfinite(begin) else 0.0
    result = RunResult(name, '', {}, span, notes=[f'{key}: {value}' for key, value in log.notes.items()])
    for method in methods:
        try:
            result.methods[method] = _evaluate(method, log, begin, span, filtered)
        except UnavailableError as error:
            result.missing[method] = str(error)
    if log.has_truth:
        result.truth = {'time': log.target['time'], 'azimuth': log.true_azimuth(log.target['time'])}
    if log.tracks is not None:
        result.tracks = log.tracks._asdict()
    result.state = {'time': log.fused['time'], 'state': log.fused['state'], 'sigma': log.fused['sigma']}
    return result


def _evaluate(method: str, log: RunLog, begin: float, span: float, filtered: bool) -> MethodResult:
    time, azimuth = bearings(method, log, filtered)
    error_time, error_deg, opposite = compare(time, azimuth, log, begin)
    folded = is_folded(method)
    result = MethodResult(time, azimuth, error_time, error_deg, np.zeros(0, bool) if folded else opposite,
                          coverage_of(begin, span, time))
    if is_tracker(method):
        series = track(method, log)
        delay = series['delay'][series['state'] != State.NONE]
    else:
        series = log.sight if method == 'sight' else log.sound
        delay = series['delay']
    if is_tracker(method) and not folded:
        result.time_to_resolve_s = time_to_resolve(log, series)
        sigma = np.degrees(np.interp(error_time, series['time'], series['sigma']))
        result.within = float(np.mean(np.abs(error_deg) < INTERVAL * sigma)) if len(error_deg) else math.nan
    if method in ('sound', 'sight'):
        fused = log.fused['time'][log.fused['state'] != State.NONE]
        arrival = dict(zip(series['time'], series['time'] + series['delay'], strict=True))
        result.held_deg = held_errors(np.array([arrival[each] for each in time]), time, azimuth, fused[fused >= begin], log)
    known = delay[np.isfinite(delay)]
    result.latency_ms = 1e3 * float(np.median(known)) if known.size else math.nan
    return result
