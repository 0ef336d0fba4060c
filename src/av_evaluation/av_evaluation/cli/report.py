"""ros2 run av_evaluation report --out DIR: the publication's experiments repeated, with one HTML report.

Our figures are beside the published ones; those that are not known here are left blank. Numbers of figures and tables are those
of the publication.
"""

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
from av_evaluation.experiments.physical import CLIPS, FILMED, detection_stage
from av_evaluation.metrics.results import RunResult, metrics_of, write_json
from av_evaluation.report.charts import bearing_chart, distribution_chart
from av_evaluation.report.page import Page
from av_evaluation.report.text import format_rows, label, rmse_cell, rmse_with_coverage, rows_of
from av_evaluation.runs.cases import Case
from av_evaluation.runs.program import add_run_options, compute, run_program

Runs = Mapping[str, Sequence[RunResult]]
DETECTOR = ', detector'  # ends the names of experiments with the shipped detector on rendered images; others have the oracle
# By the scenario that repeats it here: the publication's figure, and what it shows.
EXPERIMENTS = {
    'circle': 'Figure 9. Experiment 1: once around the rig in clear air',
    'tripod': 'Figure 11. Experiment 2: a loudspeaker on a tripod, in steps of 20 degrees',
    'fog_woodland': 'Figure 13. Experiment 3: a drone in a foggy clearing',
    'occluded_room': 'Figure 14. Experiment 4: indoors, behind columns and whiteboards',
}
# RMSE in degrees and coverage in percent of sound, sight and fused (Table 1), and RMSE of methods (Table 3).
PUBLISHED = {'circle': ('4.11°', '2.61° (52 %)', '3.28° (100 %)'), 'tripod': ('3.66°', '3.93° (40 %)', '3.50° (100 %)')}
PUBLISHED_METHODS = {'fused': 'RMSE 5.85°', 'kalman': 'RMSE 5.89°', 'sound': 'MAE ~3.1°'}
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


def cases_of(seeds: int, quick: bool, data: Path, methods: tuple[str, ...] = METHODS,
             model: str = '') -> dict[str, list[Case]]:
    """The runs of the report by experiment.

    Parameters:
        seeds: runs of each experiment.
        quick: whether to omit the runs with the detector and most recordings.
        data: folder of the recordings; where it does not exist, runs on recordings are omitted.
        methods: to evaluate.
        model: detector in the place of the shipped one, also in a quick report; '' for the shipped one.
    """
    clips = 2 if quick else 3 * seeds
    cases = {}
    if not quick or model:
        for scenario in EXPERIMENTS:
            cases[f'{scenario}{DETECTOR}'] = [
                Case(scenario, seed, methods, model=model or 'shipped') for seed in (1, 2)[:seeds]]
    for scenario in EXPERIMENTS:
        cases[scenario] = [Case(scenario, seed, methods) for seed in range(1, seeds + 1)]
    if data.exists():
        cases['filmed'] = [Case(f'{FILMED}{clip}', methods=methods, data=str(data), model=model) for clip in CLIPS[:clips]]
    return cases


def metrics_by_experiment(runs: Runs) -> dict[str, dict[str, dict[str, float | None]]]:
    """Figures by experiment and method, the content of metrics.json; `all` pools the four experiments of the publication."""
    pooled = {f'all{kind}': metrics_of(_four(runs, kind)) for kind in ('', DETECTOR) if _four(runs, kind) or not kind}
    return {**pooled, **{name: metrics_of(several) for name, several in runs.items() if several}}


def make_page(runs: Runs, metrics: Mapping[str, Mapping], command: str, methods: Sequence[str] = METHODS) -> Page:
    """The report.

    Parameters:
        runs: results by experiment.
        metrics: their figures, see `metrics_by_experiment`.
        command: by which the report is made.
        methods: that were evaluated.
    """
    page = Page('Audio-visual bearings of a drone: the experiments repeated', f'Made by `{command}`.')
    page.paragraph(
        'Each experiment is simulated several times with different noise. All methods are evaluated on identical measurements '
        'with an identical median filter. The rig follows its pointing controller. Sight is '
        'the simulator\'s visual oracle unless the detector is named. The publication resolved front and back by hand; here '
        'only sound alone is given the true hypothesis, fused is not. Intervals: bootstrap over blocks of 2 s.')
    page.heading('Table 1. Sound, sight and both')
    page.table(*senses_table(metrics, {name: name for name in metrics}), ours='all')
    page.paragraph('No physical rig was built: `filmed` stands in for its experiments. In the publication '
                   'a drone circles in the simulated experiment, and a loudspeaker stands on a tripod in the physical one. '
                   'Held is the newest direction of one sensor, at the instants of fused bearings.')
    _table_3(page, runs, methods)
    for name, title in {**EXPERIMENTS, 'filmed': 'A stand-in for physical experiments'}.items():
        if several := runs.get(name, ()):
            page.heading(title)
            for note in several[0].notes:
                page.paragraph(note)
            page.figure(bearing_chart(several[0]), f'{several[0].name}: bearing and error against time. Green: sight leads; '
                                                   'orange: sound leads.')
            page.table(*rows_of(metrics_of(several)), ours=label('fused'))
    page.heading('All errors')
    page.figure(distribution_chart(_four(runs), methods),
                'Cumulative distribution of the absolute errors in the four experiments.')
    return page


def senses_table(metrics: Mapping[str, Mapping], titles: Mapping[str, str]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of Table 1: sound, sight and both, beside the published figures.

    Parameters:
        metrics: by experiment, see `metrics_by_experiment`.
        titles: of the experiments that are shown; those without figures are left out.
    """
    rows = []
    for name, title in titles.items():
        if figures := metrics.get(name):
            held = (rmse_cell(figures[sense], 'held_rmse_deg') for sense in ('sound', 'sight'))
            rows.append([title, f'{rmse_cell(figures["fused"])}{_worse(figures)}', rmse_cell(figures['gated']), *held,
                         f'{rmse_cell(figures["sound"])}, {rmse_with_coverage(figures["sight"])}',
                         ', '.join(PUBLISHED.get(name.removesuffix(DETECTOR), '–'))])
    return ['experiment', 'fused', 'published gate', 'sound held', 'sight held',
            'sound, sight at capture (coverage of sight)', 'published: sound, sight, fused'], rows


def _worse(figures: Mapping) -> str:
    """Which sensors held alone have a smaller error than both together, at the same instants."""
    fused = figures['fused']['rmse_deg']
    held = {name: figures[name].get('held_rmse_deg') for name in ('sound', 'sight')}
    better = [name for name, error in held.items() if None not in (fused, error) and error < fused]
    return f' (worse than {" and ".join(better)})' if better else ''


def _four(runs: Runs, kind: str = '') -> list[RunResult]:
    """The runs of the publication's four experiments, with the oracle or, for the kind DETECTOR, with the detector."""
    return [run for scenario in EXPERIMENTS for run in runs.get(f'{scenario}{kind}', ())]


def _table_3(page: Page, runs: Runs, methods: Sequence[str]) -> None:
    page.heading('Table 3. Methods side by side')
    head, rows = rows_of(metrics_of(_four(runs), methods))
    for method, row in zip((None, *methods), (head, *rows), strict=True):
        row.insert(4, PUBLISHED_METHODS.get(method, '') if method else 'published')
    page.table(head, rows, ours=label('fused'))
    page.paragraph('The four experiments together. Methods of sound alone are evaluated at the centre of their window, whose '
                   'delay is their latency; trackers are evaluated at the time of their estimate.')


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
    return run_program(report, parser, arguments)


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
    make_page(runs, metrics, command, methods).write(options.out / 'report.html')
    print(format_rows(*rows_of(metrics['all'])))
    print(f'\n{sum(map(len, runs.values()))} runs in {time.monotonic() - began:.0f} s; see {options.out / "report.html"}')
    if options.readme and not failures:
        write_json(options.readme.parent / MEASURED, content)
        write_readme(options.readme, content)
        print(f'{options.readme} and {MEASURED} updated')
    return 1 if failures else 0
