"""ros2 run av_evaluation report --out DIR: the publication's experiments repeated, with one HTML report."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from av_common.arguments import whole
from av_evaluation.experiments.methods import METHODS, check_methods
from av_evaluation.experiments.physical import detection_stage
from av_evaluation.experiments.publication import cases_of, make_page, metrics_by_experiment, senses_table
from av_evaluation.metrics.results import write_json
from av_evaluation.report.text import format_rows, rows_of
from av_evaluation.runs.program import add_run_options, compute, run_program

SEEDS = 5  # runs of each experiment
MEASURED = Path('docs', 'measured', 'metrics.json')  # beside the README
BEGIN, END = '<!-- made by `make report` from docs/measured/metrics.json -->', '<!-- end of what `make report` makes -->'
# The rows of the README's table by experiment.
TITLES = {
    'circle, detector': 'drone circles in clear air',
    'tripod, detector': 'loudspeaker in steps of 20 degrees',
    'fog_woodland, detector': 'drone in fog',
    'occluded_room, detector': 'indoors, hidden now and then',
    'all, detector': 'the four together',
    'filmed': 'real video and real sound, lens covered for 55 %',
    'all': "the four, boxes by the simulator's oracle",
}


def measured_version(folder: Path) -> str:
    """The commit of a working tree with its date, and `changed` where files differ from it; empty without git.

    Parameters:
        folder: in the tree.
    """
    def git(*words: str) -> str:
        return subprocess.run(['git', '-C', str(folder), *words], capture_output=True, text=True, check=False).stdout.strip()
    commit = git('log', '-1', '--format=%h of %cs') if shutil.which('git') else ''
    return f'{commit}{", changed" if git("status", "--porcelain", "--untracked-files=no") else ""}' if commit else ''


def measured_table(content: Mapping) -> str:
    """The table of the README for the content of metrics.json and the version that was measured, as Markdown."""
    head, rows = senses_table(content['experiments'], TITLES)
    lines = [f'| {" | ".join(cells)} |' for cells in (head, *rows)]
    lines.insert(1, '|---' * len(head) + '|')
    if content.get('version'):
        lines += ['', f'Measured with commit {content["version"]}.']
    return '\n'.join(lines)


def write_readme(readme: Path, content: Mapping) -> None:
    """Replace the table between the README's marks. Raises ValueError for a README without marks.

    Parameters:
        readme: file that is changed.
        content: of metrics.json.
    """
    text = readme.read_text()
    if BEGIN not in text or END not in text:
        raise ValueError(f'{readme}: no line {BEGIN}')
    before, rest = text.split(BEGIN)
    readme.write_text(f'{before}{BEGIN}\n{measured_table(content)}\n{END}{rest.split(END)[1]}')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code, 1 where a run failed."""
    return run_program(report, make_parser(), arguments)


def report(options: argparse.Namespace) -> int:
    """Compute missing runs, write the report, and update the README where an option names it."""
    began = time.monotonic()
    if not options.data.exists():
        print(f'report: no real recordings in {options.data}: the stand-ins for physical experiments are omitted',
              file=sys.stderr)
    seeds = options.seeds or (1 if options.quick else SEEDS)
    check_methods(tuple(options.methods))
    if options.model:
        detection_stage(options.model)    # one that cannot be used would fail each run
        if options.readme:
            raise ValueError('the README shows the shipped detector: --readme and --model exclude each other')
    methods = tuple(dict.fromkeys((*METHODS, *options.methods)))
    runs, failures = compute(cases_of(seeds, options.quick, options.data, methods, options.model), options)
    runs = {name: group for name, group in runs.items() if group}
    given = (' QUICK=1' if options.quick else '') + (f' SEEDS={options.seeds}' if options.seeds else '')
    command, metrics = f'make report{given}', metrics_by_experiment(runs)
    content = {'command': command, 'version': measured_version(Path.cwd()), 'experiments': metrics}
    write_json(options.out / 'metrics.json', content)
    make_page(runs, metrics, command, options.quick, methods).write(options.out / 'report.html')
    print(format_rows(*rows_of(metrics['all'])))
    print(f'\n{sum(map(len, runs.values()))} runs in {time.monotonic() - began:.0f} s; see {options.out / "report.html"}')
    if options.readme and not failures:
        write_json(options.readme.parent / MEASURED, content)
        write_readme(options.readme, content)
        print(f'{options.readme} and {MEASURED} updated')
    return 1 if failures else 0


def make_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog='report', description=__doc__)
    add = parser.add_argument
    add('--quick', action='store_true', help='one run of each experiment')
    add('--seeds', type=whole, default=0, help=f'runs of each experiment ({SEEDS}, or 1 if quick)')
    add('--methods', nargs='+', default=[], metavar='METHOD', help='methods of other packages, beside those of the publication')
    add('--model', default='', help="a detector's ONNX file, or a detector of another package, in place of the shipped one; "
        'with --quick, too, on rendered images')
    add('--data', type=Path, default=Path('../shared/data'), help='folder of the real recordings (%(default)s)')
    add('--readme', type=Path, help=f'README whose table is updated, with {MEASURED}')
    add_run_options(parser, 'report.html, metrics.json')
    return parser
