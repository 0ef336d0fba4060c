"""The line that the monitor prints each second."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from av_common.track import State
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
