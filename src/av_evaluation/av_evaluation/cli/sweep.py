"""ros2 run av_evaluation sweep [NAME...] --out DIR: errors against noise, fog, distance, speed and spacing."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from av_evaluation.metrics.comparison import cell, number, write_json
from av_evaluation.metrics.results import RunResult, figures_together
from av_evaluation.report.charts import curve_chart
from av_evaluation.report.page import Page
from av_evaluation.runs.cases import Case
from av_evaluation.runs.program import add_run_options, compute, run_program

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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code, 1 where a run failed."""
    return run_program(sweep, make_parser(), arguments)


def sweep(options: argparse.Namespace) -> int:
    """Compute missing runs, write sweeps.json and report.html. Raises ValueError for an unknown sweep."""
    for name in options.names:
        if name not in SWEEPS:
            raise ValueError(f'{name!r} is no sweep, only {", ".join(SWEEPS)}')
    groups: dict[tuple[str, float], list[Case]] = {
        (name, value): cases for name in options.names or SWEEPS
        for value, cases in cases_of(SWEEPS[name], options.seeds, options.duration, options.out).items()}
    runs, failures = compute(groups, options)
    page = Page('Sweeps for the design of a rig',
                f'Figures over {options.seeds} runs of {options.duration:g} s for each value. The rig follows the drone; '
                f"sight is the simulator's visual oracle. Made by `{options.command}`.")
    content = {}
    for name in options.names or SWEEPS:
        content[name] = figures_of({value: several for (varied, value), several in runs.items() if varied == name})
        add_sweep(page, SWEEPS[name], content[name])
        print(f'{SWEEPS[name].title} ({SWEEPS[name].unit}): RMSE of ' + ', '.join(
            f'{value}: {by["fused"]["rmse_deg"]:.2f} deg' for value, by in content[name].items()
            if by['fused']['rmse_deg'] is not None))
    write_json(options.out / 'sweeps.json', content)
    page.write(options.out / 'report.html')
    print(f'see {options.out / "report.html"}')
    return 1 if failures else 0


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='sweep', description=__doc__)
    add = parser.add_argument
    add('names', nargs='*', metavar='NAME', help=f'of {", ".join(SWEEPS)}; all by default')
    add('--seeds', type=int, default=2, help='runs of each value (%(default)s)')
    add('--duration', type=float, default=30.0, help='of each run in s (%(default)s)')
    add_run_options(parser, 'report.html, sweeps.json')
    return parser


if __name__ == '__main__':
    sys.exit(main())
