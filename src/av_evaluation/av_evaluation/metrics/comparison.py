"""Comparison of methods: metrics.json and report of an evaluation, and sigma by sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from av_common.track import State
from av_evaluation.metrics.results import RunResult, figures_together, methods_of, metrics_of, write_json
from av_evaluation.metrics.statistics import INTERVAL
from av_evaluation.report.charts import bearing_chart, distribution_chart
from av_evaluation.report.page import Page
from av_evaluation.report.text import label, rows_of


def write_report(runs: Sequence[RunResult], failures: Sequence[str], out: Path, command: str) -> Path:
    """Write metrics.json, runs.json and report.html; returns the path of the report.

    Parameters:
        runs: to report.
        failures: which runs failed, with the reasons.
        out: existing folder.
        command: by which the report was made.
    """
    metrics = metrics_of(runs)
    write_json(out / 'metrics.json', metrics)
    write_json(out / 'runs.json', [
        {'name': run.name, 'case': run.case, 'notes': run.notes, 'missing': run.missing,
         **{key: value if math.isfinite(value) else None
            for key, value in (('in_picture', run.in_picture), ('seen_s', run.seen_s))},
         'tracks': {key: value if math.isfinite(value) else None for key, value in run.tracks.items()} or None,
         'methods': {method: figures_together([run], method) for method in run.methods}} for run in runs])
    page = Page('Evaluation of bearings', f'{len(runs)} runs. Made by `{command}`.')
    page.heading('All runs together')
    page.table(*rows_of(metrics), ours=label('fused'))
    page.paragraph('Errors count from the first detection; without one, from the first bearing with resolved front '
                   'and back. All methods get the same data and the same median filter. Methods of sound alone, and the '
                   'Kalman filter, are given the true one of two hypotheses; those of sound are evaluated at the centre of '
                   'their window. Fused, gated and sight use no truth. Intervals: bootstrap over blocks of 2 s.')
    page.figure(distribution_chart(runs, methods_of(runs)), 'Cumulative distribution of the absolute errors.')
    inputs = list(dict.fromkeys(run.case['input'] for run in runs))
    if len(inputs) > 1:
        page.heading('By input')
        for name in inputs:
            page.heading(name, 3)
            page.table(*rows_of(metrics_of([run for run in runs if run.case['input'] == name])), ours=label('fused'))
    page.heading('Run by run')
    for run in runs:
        page.heading(run.name, 3)
        for text in (*run.notes, *run.missing.values()):
            page.paragraph(text)
        page.figure(bearing_chart(run), f'{run.name}: bearing and error.')
    for failure in failures:
        page.paragraph(failure)
    page.write(out / 'report.html')
    return out / 'report.html'


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
