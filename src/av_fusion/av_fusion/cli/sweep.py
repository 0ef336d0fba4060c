"""ros2 run av_fusion sweep [NAME...] --out DIR: what a figure owes to noise, fog, distance, speed and the rig's build."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from av_fusion.evaluation.comparison import write_json
from av_fusion.evaluation.page import Page
from av_fusion.evaluation.progress import RunProgress
from av_fusion.evaluation.schedule import run_cases
from av_fusion.evaluation.sweeps import SWEEPS, add_sweep, cases_of, figures_of


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is not there yet, write sweeps.json and report.html. Returns 0, or 1 where a run failed."""
    parser = make_parser()
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in SWEEPS:
            parser.error(f'{name!r} is no sweep, only {", ".join(SWEEPS)}')
    groups = {(name, value): cases for name in options.names or SWEEPS
              for value, cases in cases_of(SWEEPS[name], options.seeds, options.duration, options.out).items()}
    try:
        results, failures = run_cases([case for cases in groups.values() for case in cases], options.out / 'runs',
                                      options.workers, options.scheduler, RunProgress(options.quiet).show)
    except (ValueError, OSError) as error:
        print(f'sweep: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f'\nsweep: interrupted; the same command goes on where it stopped ({options.out})', file=sys.stderr)
        return 130
    for name, why in failures.items():
        print(f'sweep: {name}: {why}', file=sys.stderr)
    done = {result.key: result for result in results}
    page = Page('What rig to build', f'Medians and pooled errors over {options.seeds} runs each. '
                'The drone is followed by the rig; sight is the simulator\'s visual oracle.')
    content = {}
    for name in options.names or SWEEPS:
        content[name] = figures_of({value: [done[case.key] for case in cases if case.key in done]
                                    for (sweep, value), cases in groups.items() if sweep == name})
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
    add('names', nargs='*', metavar='NAME', help=f'of {", ".join(SWEEPS)}; all without')
    add('--out', type=Path, required=True, help='folder for report.html, sweeps.json and what each run gave')
    add('--seeds', type=int, default=2, help='runs of each value (%(default)s)')
    add('--duration', type=float, default=30.0, help='seconds of each run (%(default)s)')
    add('--workers', type=int, default=0, help='parallel processes; 0: one a core')
    add('--scheduler', default='', metavar='ADDRESS', help='of a Dask cluster that computes the runs instead')
    add('--quiet', action='store_true', help='no progress')
    return parser


if __name__ == '__main__':
    sys.exit(main())
