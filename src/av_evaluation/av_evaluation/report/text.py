"""What the monitor prints: a line each second, and the table of figures at the end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from av_common.track import State
from av_evaluation.metrics.metrics import Errors, Summary
from av_pointing.controller import Mode

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


ROWS = (('coverage', 'coverage', '{:.1f} %', 100.0), ('RMSE', 'rmse_deg', '{:.2f} deg', 1.0),
        ('mean error', 'mae_deg', '{:.2f} deg', 1.0), ('median error', 'median_deg', '{:.2f} deg', 1.0),
        ('95th percentile', 'p95_deg', '{:.2f} deg', 1.0), ('errors > 20 deg', 'outliers', '{:.1f} %', 100.0),
        ('hemisphere wrong', 'hemisphere_errors', '{:.1f} %', 100.0), ('rate', 'rate_hz', '{:.1f} Hz', 1.0),
        ('delay, median', 'delay_median_ms', '{:.0f} ms', 1.0), ('delay, 95th perc.', 'delay_p95_ms', '{:.0f} ms', 1.0))
LABEL_WIDTH = 24


def format_table(summary: Summary) -> str:
    """One row for each figure, one column for each series, then the figures of the whole run."""
    names = list(summary.senses)
    lines = [f'{"":<{LABEL_WIDTH}}' + ''.join(f'{name:>14}' for name in names)]
    lines += [f'{label:<{LABEL_WIDTH}}' + ''.join(f'{_cell(summary.senses[name], key, form, scale):>14}' for name in names)
              for label, key, form, scale in ROWS]
    lines.append(f'{"front/back resolved in":<{LABEL_WIDTH}}{_number(summary.time_to_resolve, "{:.1f} s"):>14}')
    lines.append(f'{"switches":<{LABEL_WIDTH}}{summary.switches:>14}')
    lines += [f'{key:<{LABEL_WIDTH}}  {value}' for key, value in summary.notes.items()]
    return '\n'.join(lines)


def _cell(errors: Errors, key: str, form: str, scale: float) -> str:
    return _number(scale * getattr(errors, key), form)


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else '-'
