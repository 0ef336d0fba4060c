"""The README's table of measured values, made from metrics.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from av_evaluation.metrics.comparison import cell

BEGIN, END = '<!-- made by `make report` from docs/measured/metrics.json -->', '<!-- end of what `make report` makes -->'
# Title of each experiment, and the source of its detections.
EXPERIMENTS = {
    'circle, detector': ('drone circles in clear air', 'shipped detector'),
    'tripod, detector': ('loudspeaker in steps', 'shipped detector'),
    'fog_woodland, detector': ('drone in fog', 'shipped detector'),
    'occluded_room, detector': ('indoors, hidden now and then', 'shipped detector'),
    'all, detector': ('the four together', 'shipped detector'),
    'filmed': ('real video, real sound through measured ears, lens covered for 55 %', 'shipped detector'),
    'circle': ('drone circles in clear air', "simulator's oracle"),
    'tripod': ('loudspeaker in steps', "simulator's oracle"),
    'fog_woodland': ('drone in fog', "simulator's oracle"),
    'occluded_room': ('indoors, hidden now and then', "simulator's oracle"),
    'all': ('the four together', "simulator's oracle"),
}


def measured_table(content: Mapping) -> str:
    """The table of the README for the content of metrics.json, as Markdown."""
    lines = ['| experiment | detections from | sound alone, RMSE | sight alone, RMSE (coverage) | fused, RMSE (coverage) '
             '| published gate, RMSE | wrong side | front/back resolved in | command |',
             '|---|---|---|---|---|---|---|---|---|']
    for name, (title, detections) in EXPERIMENTS.items():
        figures = content['experiments'].get(name)
        if figures:
            fused = figures['fused']
            cells = [_rmse(figures['sound']), _both(figures['sight']), _both(fused), _rmse(figures['gated']),
                     cell(fused, 'hemisphere_errors', 100.0, '{:.1f} %'), cell(fused, 'time_to_resolve_s', 1.0, '{:.1f} s')]
            lines.append(f'| {title} | {detections} | {" | ".join(cells)} | `{content["command"]}` |')
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


def disagreement(readme: Path, metrics: Path) -> str:
    """The difference between the table of the README and that of metrics.json, empty if they agree.

    Parameters:
        readme: file with the marks.
        metrics: file of measured values.
    """
    expected = measured_table(json.loads(metrics.read_text()))
    written = readme.read_text().split(BEGIN)[-1].split(END)[0].strip()
    return '' if written == expected else f'{readme} has\n{written}\nbut {metrics} gives\n{expected}'


def _rmse(figures: Mapping) -> str:
    return cell(figures, 'rmse_deg', 1.0, '{:.2f} deg')


def _both(figures: Mapping) -> str:
    return f'{_rmse(figures)} ({cell(figures, "coverage", 100.0, "{:.0f} %")})' if figures['rmse_deg'] is not None else '–'
