"""A run as a picture: truth, sound, sight and bearing against time, with who led when."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from av_common.angles import wrap
from av_fusion.evaluation.run_log import RunLog
from av_fusion.measurements import State

SHADES = {State.VISUAL_ACTIVE: ('#cfe8cf', 'sight leads'), State.ACOUSTIC_ACTIVE: ('#fbe3c0', 'sound leads'),
          State.COASTING: ('#e0e0e0', 'coasting')}


def draw(log: RunLog, path: Path | BinaryIO, title: str = '') -> None:
    """Write the picture as PNG to a file."""
    figure = Figure(figsize=(12, 7), layout='constrained')
    FigureCanvasAgg(figure)
    bearing, error = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    starts = [series['time'].min() for series in (log.fused, log.sound, log.sight, log.target) if len(series)]
    start = min(starts, default=0.0)
    _shade((bearing, error), log, start)
    for name in ('azimuth', 'mirrored'):
        bearing.plot(log.sound['time'] - start, np.degrees(log.sound[name]), '.', color='#d98200', markersize=2, alpha=0.5,
                     label='sound, both mirror images' if name == 'azimuth' else None)
    bearing.plot(log.sight['time'] - start, np.degrees(log.sight['azimuth']), '.', color='#1a7f37', markersize=4, label='sight')
    time = log.fused['time']
    bearing.plot(time - start, np.degrees(_broken(log.fused['azimuth'])), color='#1f4fd8', linewidth=1.2, label='fused')
    if log.has_truth:
        truth = log.true_azimuth(time)
        bearing.plot(time - start, np.degrees(_broken(truth)), '--', color='black', linewidth=1.0, label='truth')
        error.plot(time - start, np.degrees(wrap(log.fused['azimuth'] - truth)), color='#1f4fd8', linewidth=0.8)
        sigma = 2.0 * np.degrees(log.fused['sigma'])
        error.fill_between(time - start, -sigma, sigma, color='#1f4fd8', alpha=0.15, linewidth=0)
    error.set(xlabel='time (s)', ylabel='error (deg)', ylim=(-15, 15))
    bearing.set(ylabel="azimuth in the rig's frame (deg)", ylim=(-185, 185), yticks=range(-180, 181, 45), title=title)
    bearing.grid(alpha=0.3)
    error.grid(alpha=0.3)
    bearing.legend(loc='upper right', ncols=4, markerscale=3)
    figure.savefig(path, dpi=110, format='png')


def _shade(axes: tuple, log: RunLog, start: float) -> None:
    time, state = log.fused['time'] - start, log.fused['state']
    if not len(time):
        return
    edges = np.concatenate([[0], np.flatnonzero(np.diff(state)) + 1, [len(state) - 1]])
    labelled = set()
    for begin, end in pairwise(edges):
        if state[begin] in SHADES:
            colour, label = SHADES[State(int(state[begin]))]
            for axis in axes:
                axis.axvspan(time[begin], time[end], color=colour, linewidth=0, zorder=0,
                             label=label if axis is axes[0] and label not in labelled else None)
            labelled.add(label)


def _broken(azimuth: np.ndarray) -> np.ndarray:
    """The curve with gaps where it wraps, so that no line is drawn across the picture."""
    broken = azimuth.copy()
    broken[1:][np.abs(np.diff(azimuth)) > np.pi] = np.nan
    return broken
