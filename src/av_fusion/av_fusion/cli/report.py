"""ros2 run av_fusion report --out DIR: the paper's experiments, made again, and one HTML report of them."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from av_fusion.evaluation.comparison import format_rows, rows_of, write_json
from av_fusion.evaluation.measured import write_readme
from av_fusion.evaluation.paper import cases_of, make_page, metrics_by_experiment
from av_fusion.evaluation.progress import RunProgress
from av_fusion.evaluation.schedule import run_cases

SEEDS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is not there yet, write the report. Returns 0, or 1 where a run failed."""
    options = make_parser().parse_args(arguments)
    began = time.monotonic()
    seeds = options.seeds or (1 if options.quick else SEEDS)
    groups = cases_of(seeds, options.quick, options.data)
    if not options.data.exists():
        print(f'report: no real recordings in {options.data}: the stand-ins for physical experiments are left out',
              file=sys.stderr)
    cases = list(dict.fromkeys(case for group in groups.values() for case in group))
    try:
        results, failures = run_cases(cases, options.out / 'runs', options.workers, options.scheduler,
                                      RunProgress(options.quiet).show)
    except (ValueError, OSError) as error:
        print(f'report: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f'\nreport: interrupted; the same command goes on where it stopped ({options.out})', file=sys.stderr)
        return 130
    for name, why in failures.items():
        print(f'report: {name}: {why}', file=sys.stderr)
    done = {result.key: result for result in results}
    runs = {name: [done[case.key] for case in group if case.key in done] for name, group in groups.items()}
    runs = {name: group for name, group in runs.items() if group}
    given = (' QUICK=1' if options.quick else '') + (f' SEEDS={options.seeds}' if options.seeds else '')
    content = {'command': f'make report{given}', 'experiments': metrics_by_experiment(runs)}
    write_json(options.out / 'metrics.json', content)
    make_page(runs, content['command'], options.quick).write(options.out / 'report.html')
    print(format_rows(*rows_of(content['experiments']['all'])))
    print(f'\n{len(results)} runs in {time.monotonic() - began:.0f} s; see {options.out / "report.html"}')
    if options.readme and not failures:
        options.measured.parent.mkdir(parents=True, exist_ok=True)
        write_json(options.measured, content)
        write_readme(options.readme, content)
        print(f'{options.readme} and {options.measured} brought up to date')
    return 1 if failures else 0


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='report', description=__doc__)
    add = parser.add_argument
    add('--out', type=Path, required=True, help='folder for report.html, metrics.json and what each run gave')
    add('--quick', action='store_true', help='one run of each experiment')
    add('--seeds', type=int, default=0, help=f'runs of each experiment ({SEEDS}, or 1 if quick)')
    add('--data', type=Path, default=Path('../shared/data'), help='folder of the real recordings (%(default)s)')
    add('--readme', type=Path, help='bring the table of this README up to date ...')
    add('--measured', type=Path, default=Path('docs/measured/metrics.json'), help='... and this file (%(default)s)')
    add('--workers', type=int, default=0, help='parallel processes; 0: one a core')
    add('--scheduler', default='', metavar='ADDRESS', help='of a Dask cluster that computes the runs instead')
    add('--quiet', action='store_true', help='no progress')
    return parser


if __name__ == '__main__':
    sys.exit(main())
