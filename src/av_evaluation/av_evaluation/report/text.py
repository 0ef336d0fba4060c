"""What programs print: the monitor's line of each second, and the table of figures of methods."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from av_common.track import State
from av_pointing.controller import Mode

Figures = Mapping[str, float | None]
COLUMNS = (('coverage', 'coverage', 100.0, '{:.1f} %'), ('rmse_deg', 'RMSE', 1.0, '{:.2f}°'),
           ('mae_deg', 'mean', 1.0, '{:.2f}°'), ('median_deg', 'median', 1.0, '{:.2f}°'), ('p95_deg', '95th', 1.0, '{:.2f}°'),
           ('outliers', '> 20°', 100.0, '{:.1f} %'), ('hemisphere_errors', 'wrong side', 100.0, '{:.1f} %'),
           ('within', 'in 1.64 σ', 100.0, '{:.0f} %'), ('worst_rmse_deg', 'worst run', 1.0, '{:.2f}°'),
           ('time_to_resolve_s', 'resolved in', 1.0, '{:.1f} s'), ('latency_ms', 'latency', 1.0, '{:.0f} ms'))
LABELS = {'fused': 'fused (ours)', 'sound': 'sound alone (ours)', 'sight': 'sight alone', 'gated': 'published gate',
          'kalman': 'Kalman filter', 'moving_average': 'moving average', 'gcc_phat': 'GCC-PHAT', 'music': 'MUSIC',
          'mvdr': 'MVDR'}
MARKS = {State.NONE: 'no target', State.VISUAL_ACTIVE: 'sight', State.ACOUSTIC_ACTIVE: 'sound', State.COASTING: 'coasting'}

MOST_TARGETS = 10  # whose ids are shown


def format_status(elapsed: float, bearing: Any | None, state: Any | None, targets: Any | None, command: Any | None,
                  truth: float, rates: Mapping[str, float], delay: float, problems: Mapping[str, str]) -> str:
    """One line of state, bearing, confidences, command, rates and delay, and a line for each problem.

    Parameters:
        elapsed (s): since the start.
        bearing: newest `Bearing`, or None.
        state: newest `FusionState`, or None.
        targets: newest `TrackArray`, or None; of several the ids are shown.
        command: newest `PointingCommand`, or None.
        truth (rad): true azimuth in the body frame, nan where unknown.
        rates (Hz): of messages, by name.
        delay (s): from the newest measurement to its bearing, nan where unknown.
        problems: of nodes, by their names.
    """
    parts = [f'{elapsed:5.0f} s']
    if bearing is None or bearing.state == State.NONE:
        parts.append(f'{MARKS[State.NONE]:<9} {"":<17}')
    else:
        state_of_bearing = State(min(bearing.state, max(State)))  # others count as COASTING
        parts.append(f'{MARKS[state_of_bearing]:<9} {math.degrees(bearing.azimuth):+6.1f} deg +-{_sigma(bearing):4.1f}')
    if math.isfinite(truth):
        parts.append(f'truth {math.degrees(truth):+6.1f}')
    if state is not None:
        hemisphere = 'resolved' if bearing is not None and bearing.resolved else 'ambiguous'
        parts.append(f'conf sound {state.sound_confidence:.2f} sight {state.sight_confidence:.2f}')
        parts.append(f'front {100.0 * state.front_probability:3.0f} % {hemisphere}')
    if targets is not None and len(targets.tracks) > 1:
        shown = [f'[{track.id}]' if track.id == targets.selected else str(track.id) for track in targets.tracks[:MOST_TARGETS]]
        parts.append(f'{len(targets.tracks)} targets {" ".join(shown)}')
    if command is not None:
        moving = f'{math.degrees(command.yaw_rate):+4.0f} deg/s' if command.move_body else ''
        parts.append(f'{Mode(command.mode).name.lower():<6} {moving}')
    parts.append('Hz ' + ' '.join(f'{name} {rate:.0f}' for name, rate in rates.items()))
    if math.isfinite(delay):
        parts.append(f'delay {1e3 * delay:3.0f} ms')
    lines = ' | '.join(parts)
    for name, message in problems.items():
        lines += f'\n        ! {name}: {message}'
    return lines


def _sigma(bearing: Any) -> float:
    return math.degrees(math.sqrt(bearing.azimuth_variance)) if 0.0 <= bearing.azimuth_variance < math.inf else 99.9


def label(method: str) -> str:
    """Name of a method in tables and figures."""
    return LABELS.get(method, method)


def cell(figures: Figures, key: str, scale: float, form: str) -> str:
    """A figure as text, a dash where there is none.

    Parameters:
        figures: of a method.
        key: of the figure.
        scale: factor from the figure to the unit of the text.
        form: format with the unit.
    """
    value = figures.get(key)
    return form.format(scale * value) if value is not None else '–'


def rmse_cell(figures: Figures, key: str = 'rmse_deg') -> str:
    """The RMSE as text, or another angle by its key."""
    return cell(figures, key, 1.0, '{:.2f}°')


def rmse_with_coverage(figures: Figures) -> str:
    """RMSE and coverage as text."""
    covered = '' if figures['rmse_deg'] is None else f' ({cell(figures, "coverage", 100.0, "{:.0f} %")})'
    return f'{rmse_cell(figures)}{covered}'


def interval(figures: Figures) -> str:
    """The confidence interval of the RMSE as text."""
    low, high = figures.get('rmse_low_deg'), figures.get('rmse_high_deg')
    return '–' if low is None or high is None else f'{low:.2f}–{high:.2f}°'


def rows_of(metrics: Mapping[str, Figures]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of methods."""
    head = ['method', *(name for _, name, _, _ in COLUMNS)]
    rows = [[label(method), *(cell(figures, key, scale, form) for key, _, scale, form in COLUMNS)]
            for method, figures in metrics.items()]
    for row, text in zip((head, *rows), ('95 % interval', *map(interval, metrics.values())), strict=True):
        row.insert(3, text)    # behind the RMSE
    return head, rows


def format_rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as text with aligned columns.

    Parameters:
        head: cells of the header.
        rows: cells of each row.
    """
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]
    return '\n'.join('  '.join(text.ljust(width) if not column else text.rjust(width)
                               for column, (text, width) in enumerate(zip(row, widths, strict=True))) for row in (head, *rows))
