"""Sweeps: figures against one varied quantity of rig, drone or weather, for the design of a rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from av_evaluation.metrics.comparison import cell, number
from av_evaluation.metrics.results import RunResult, figures_together
from av_evaluation.report.charts import curve_chart
from av_evaluation.report.page import Page
from av_evaluation.runs.cases import Case

METHODS = ('sound', 'sight', 'fused')
Changes = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Sweep:
    """A varied quantity.

    Parameters:
        title: of the quantity.
        unit: of its values.
        scenario: that is changed.
        values: of the quantity.
        changes: from a value to those of the scenario's file, see `Case.changes`.
        array: whether the value is the distance between the microphones (m) instead.
    """

    title: str
    unit: str
    scenario: str
    values: tuple[float, ...]
    changes: Callable[[float], Changes]
    array: bool = False


SWEEPS = {
    'snr': Sweep('Signal-to-noise ratio at 10 m', 'dB', 'fog_woodland', (-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 20.0),
                 lambda value: (('noise.snr.ratio_db', value),)),
    'fog': Sweep('Extinction of the fog, drone at 10 m', '1/m', 'circle', (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4),
                 lambda value: (('weather.fog', value),)),
    'distance': Sweep('Distance of the drone, 10 dB at 10 m', 'm', 'circle', (5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0),
                      lambda value: (('targets.0.trajectory.radius', value),)),
    'speed': Sweep('Angular speed of the drone, in clear air', 'deg/s', 'circle', (5.0, 10.0, 20.0, 30.0, 45.0, 60.0),
                   lambda value: (('targets.0.trajectory.period', 360.0 / value),)),
    'spacing': Sweep('Distance between the microphones', 'm', 'fog_woodland', (0.05, 0.1, 0.15, 0.2, 0.3, 0.5),
                     lambda value: (), array=True),
    'ego_noise': Sweep('Drone at 10 m over ego-noise of the rotors', 'dB', 'ego_rotors',
                       (-20.0, -15.0, -10.0, -5.0, 0.0, 10.0),
                       lambda value: (('noise.snr.ratio_db', value),)),
}


def cases_of(sweep: Sweep, seeds: int, duration: float, out: Path) -> dict[float, list[Case]]:
    """The runs of a sweep by value.

    Parameters:
        sweep: to compute.
        seeds: runs of each value.
        duration (s): of a run.
        out: folder for array files.
    """
    return {value: [Case(sweep.scenario, seed, METHODS, duration=duration, changes=sweep.changes(value),
                         array=_pair(value, out) if sweep.array else '') for seed in range(1, seeds + 1)]
            for value in sweep.values}


def _pair(spacing: float, out: Path) -> str:
    """File of an array of two microphones at a distance `spacing` (m)."""
    file = (out / f'pair_{spacing:g}.yaml').absolute()
    if not file.exists():
        out.mkdir(parents=True, exist_ok=True)
        file.write_text(f'name: pair_{spacing:g}\nmicrophones:\n'
                        f'  - [0.0, {spacing / 2}, 0.0]\n  - [0.0, {-spacing / 2}, 0.0]\n')
    return str(file)


def figures_of(runs: Mapping[float, Sequence[RunResult]]) -> dict[str, dict[str, dict[str, float | None]]]:
    """Figures by value and method; values without runs are left out."""
    return {f'{value:g}': {method: figures_together(several, method, intervals=False) for method in METHODS}
            for value, several in runs.items() if several}


def add_sweep(page: Page, sweep: Sweep, figures: dict[str, dict[str, dict[str, float | None]]]) -> None:
    """Add charts and table of a sweep.

    Parameters:
        page: that gets them.
        sweep: varied quantity.
        figures: by value and method, see `figures_of`.
    """
    values = [float(value) for value in figures]
    page.heading(sweep.title)
    for key, scale, name, log in (('rmse_deg', 1.0, 'RMSE (deg)', True), ('coverage', 100.0, 'coverage (%)', False)):
        curves = {method: (values, [scale * number(by[method], key) for by in figures.values()])
                  for method in METHODS}
        page.figure(curve_chart(curves, f'{sweep.title} ({sweep.unit})', name, log), f'{name} by method.')
    head = [sweep.unit, *(f'{method}: RMSE' for method in METHODS), *(f'{method}: coverage' for method in METHODS),
            'fused: wrong side', 'resolved in']
    page.table(head, [[value, *(cell(by[method], 'rmse_deg', 1.0, '{:.2f}°') for method in METHODS),
                       *(cell(by[method], 'coverage', 100.0, '{:.0f} %') for method in METHODS),
                       cell(by['fused'], 'hemisphere_errors', 100.0, '{:.1f} %'),
                       cell(by['fused'], 'time_to_resolve_s', 1.0, '{:.1f} s')] for value, by in figures.items()])
