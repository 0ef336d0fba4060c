"""ros2 run av_fusion evaluate SCENARIO... --out DIR: how well each method does, over several seeds, on identical data."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from av_fusion.evaluation.cases import Case, run_cases
from av_fusion.evaluation.methods import METHODS
from av_sim_bridge.config_reader import ConfigError

COLUMNS = (('coverage', 'coverage', 100.0, '%'), ('rmse_deg', 'RMSE', 1.0, 'deg'), ('mae_deg', 'mean', 1.0, 'deg'),
           ('median_deg', 'median', 1.0, 'deg'), ('p95_deg', '95th', 1.0, 'deg'), ('outliers', '> 20 deg', 100.0, '%'),
           ('hemisphere_errors', 'wrong side', 100.0, '%'))


def main(arguments: list[str] | None = None) -> int:
    """Evaluate, print the table, write metrics.json. Returns the exit code."""
    options = _parser().parse_args(arguments)
    cases = [Case(scenario, seed, tuple(options.methods), options.model, not options.static, options.duration,
                  tuple(options.taus)) for scenario in options.inputs for seed in range(1, options.seeds + 1)]
    try:
        results = list(run_cases(cases, options.out / 'cases', options.workers, _progress))
    except (ConfigError, OSError, ValueError) as error:
        print(f'evaluate: {error}', file=sys.stderr)
        return 2
    metrics = {method: combine([result['methods'][method] for result in results]) for method in options.methods}
    worst = {method: combine([result['methods'][method] for result in results], np.nanmax) for method in options.methods}
    _print_table(metrics, worst)
    decided = [result['time_to_decide'] for result in results]
    print(f'\nfront/back told in {np.nanmedian(decided):.1f} s (median), {np.nanmax(decided):.1f} s (worst); '
          f'sight alone covers {100 * np.nanmedian([result["sight_coverage"] for result in results]):.0f} %')
    taus = {tau: {method: combine([result['taus'][tau][method] for result in results]) for method in ('fused', 'gated')}
            for tau in results[0]['taus']}
    if taus:
        print('\nRMSE (deg) by tau\n' + '\n'.join(
            f'{tau:>5}' + ''.join(f'  {method} {figures["rmse_deg"]:6.2f}' for method, figures in methods.items())
            for tau, methods in taus.items()))
    (options.out / 'metrics.json').write_text(json.dumps({**metrics, 'worst': worst, 'taus': taus}, indent=2) + '\n')
    return 0


def combine(figures: list[dict], how: object = np.nanmedian) -> dict:
    """Each figure over the cases: the median, or `how` else."""
    keys = figures[0]
    return {key: float(how([np.nan if f[key] is None else f[key] for f in figures])) if any(
        f[key] is not None and np.isfinite(f[key]) for f in figures) else None for key in keys}


def _print_table(metrics: dict, worst: dict) -> None:
    print(f'{"median (worst RMSE)":<20}' + ''.join(f'{f"{label} ({unit})":>16}' for _, label, _, unit in COLUMNS))
    for method, figures in metrics.items():
        cells = [f'{scale * figures[key]:.2f}' if figures[key] is not None else '-' for key, _, scale, _ in COLUMNS]
        cells[1] += f' ({worst[method]["rmse_deg"]:.2f})' if worst[method]['rmse_deg'] is not None else ''
        print(f'{method:<20}' + ''.join(f'{cell:>16}' for cell in cells))


def _progress(done: int, total: int) -> None:
    print(f'\r{done}/{total} runs', end='\n' if done == total else '', file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='evaluate', description=__doc__)
    parser.add_argument('inputs', nargs='+', metavar='SCENARIO', help='a shipped scenario or a file')
    parser.add_argument('--out', type=Path, required=True, help='folder for metrics.json, and a picture and figures a run')
    parser.add_argument('--seeds', type=int, default=3, help='runs of each scenario (3)')
    parser.add_argument('--methods', nargs='+', choices=METHODS, default=list(METHODS))
    parser.add_argument('--model', default='', help="detector's ONNX file, looking at rendered pictures; "
                        "without it the simulator's oracle stands in")
    parser.add_argument('--static', action='store_true', help='the rig turns as the scenario says, not to the target')
    parser.add_argument('--duration', type=float, default=0.0, help="seconds; 0: the scenario's")
    parser.add_argument('--taus', nargs='*', type=float, default=[], help='further gates for fused and gated')
    parser.add_argument('--workers', type=int, default=0, help='parallel processes; 0: one a core')
    return parser


if __name__ == '__main__':
    sys.exit(main())
