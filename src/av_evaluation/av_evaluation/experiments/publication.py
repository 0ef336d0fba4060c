"""The publication's experiments repeated: the runs of each, and the report with our figures beside the published ones.

Figures of the publication that are not known here are left blank. Numbers of figures and tables are those of the publication.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from av_evaluation.experiments.methods import METHODS
from av_evaluation.experiments.physical import CLIPS, FILMED
from av_evaluation.metrics.results import RunResult, metrics_of
from av_evaluation.report.charts import bearing_chart, distribution_chart
from av_evaluation.report.page import Page
from av_evaluation.report.text import label, rmse_cell, rmse_with_coverage, rows_of
from av_evaluation.runs.cases import Case

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


def make_page(runs: Runs, metrics: Mapping[str, Mapping], command: str, quick: bool, methods: Sequence[str] = METHODS) -> Page:
    """The report.

    Parameters:
        runs: results by experiment.
        metrics: their figures, see `metrics_by_experiment`.
        command: by which the report is made.
        quick: whether there is one run of each experiment only.
        methods: that were evaluated.
    """
    page = Page('Audio-visual bearings of a drone: the experiments repeated',
                f'Made by `{command}`' + (', the quick version: one run of each.' if quick else '.'))
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
