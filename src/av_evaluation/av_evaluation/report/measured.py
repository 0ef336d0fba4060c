"""The README's table of measured values, made from metrics.json."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path

from av_evaluation.experiments.publication import PUBLISHED
from av_evaluation.metrics.comparison import cell

BEGIN, END = '<!-- made by `make report` from docs/measured/metrics.json -->', '<!-- end of what `make report` makes -->'
# Title of each experiment, and what it repeats in `PUBLISHED`.
EXPERIMENTS = {
    'circle, detector': ('drone circles in clear air', 'circle'),
    'tripod, detector': ('loudspeaker in steps of 20 degrees', 'tripod'),
    'fog_woodland, detector': ('drone in fog', ''),
    'occluded_room, detector': ('indoors, hidden now and then', ''),
    'all, detector': ('the four together', ''),
    'filmed': ('real video and real sound, lens covered for 55 %', ''),
    'all': ("the four, boxes by the simulator's oracle", ''),
}


def measured_version(folder: Path) -> str:
    """The commit of a working tree with its date, and `changed` where files differ from it; empty outside of git.

    Parameters:
        folder: in the tree.
    """
    def git(*words: str) -> str:
        return subprocess.run(['git', '-C', str(folder), *words], capture_output=True, text=True, check=False).stdout.strip()
    commit = git('log', '-1', '--format=%h of %cs')
    return f'{commit}{", changed" if git("status", "--porcelain", "--untracked-files=no") else ""}' if commit else ''


def measured_table(content: Mapping) -> str:
    """The table of the README for the content of metrics.json and the version that was measured, as Markdown."""
    lines = ['| experiment | sound alone | sight alone (coverage) | fused | published gate | published: sound, sight, fused |',
             '|---|---|---|---|---|---|']
    for name, (title, published) in EXPERIMENTS.items():
        figures = content['experiments'].get(name)
        if figures:
            cells = [_rmse(figures['sound']), _both(figures['sight']), f'{_rmse(figures["fused"])}{_worse(figures)}',
                     _rmse(figures['gated']), ', '.join(PUBLISHED[published][1:]) if published else '–']
            lines.append(f'| {title} | {" | ".join(cells)} |')
    if content.get('version'):
        lines += ['', f'Measured with commit {content["version"]}.']
    return '\n'.join(lines)


def _worse(figures: Mapping) -> str:
    """Which sensors alone have a smaller error than both together."""
    fused = figures['fused']['rmse_deg']
    better = [name for name in ('sound', 'sight') if None not in (fused, figures[name]['rmse_deg'])
              and figures[name]['rmse_deg'] < fused]
    return f' (worse than {" and ".join(better)})' if better else ''


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
    return cell(figures, 'rmse_deg', 1.0, '{:.2f}°')


def _both(figures: Mapping) -> str:
    return f'{_rmse(figures)} ({cell(figures, "coverage", 100.0, "{:.0f} %")})' if figures['rmse_deg'] is not None else '–'
