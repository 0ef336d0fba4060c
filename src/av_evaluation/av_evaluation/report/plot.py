"""The plot of a run: truth, measurements and estimated bearing against time, with the state of the track."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.metrics.run_log import RunLog

SHADES = {State.VISUAL_ACTIVE: ('#cfe8cf', 'sight leads'), State.ACOUSTIC_ACTIVE: ('#fbe3c0', 'sound leads'),
          State.COASTING: ('#e0e0e0', 'coasting')}


def draw(log: RunLog, path: Path | BinaryIO, title: str = '') -> None:
    """Plot a run: azimuths above, the error with its interval of 2 sigma below.

    Parameters:
        log: of the run.
        path: file, or open binary file, to which the PNG is written.
        title: of the plot.
    """
    figure = Figure(figsize=(12, 7), layout='constrained')
    FigureCanvasAgg(figure)
    bearing, error = figure.subplots(2, 1, sharex=True, gridspec_kw={'height_ratios': [3, 1]})
    starts = [series['time'].min() for series in (log.fused, log.sound, log.sight, log.target) if len(series)]
    start = min(starts, default=0.0)
    shade((bearing, error), log.fused['time'] - start, log.fused['state'])
    for name in ('azimuth', 'mirrored'):
        bearing.plot(log.sound['time'] - start, np.degrees(log.sound[name]), '.', color='#d98200', markersize=2, alpha=0.5,
                     label='sound, both hypotheses' if name == 'azimuth' else None)
    bearing.plot(log.sight['time'] - start, np.degrees(log.sight['azimuth']), '.', color='#1a7f37', markersize=4, label='sight')
    time = log.fused['time']
    bearing.plot(time - start, np.degrees(broken(log.fused['azimuth'])), color='#1f4fd8', linewidth=1.2, label='fused')
    if log.has_truth:
        truth = log.true_azimuth(time)
        bearing.plot(time - start, np.degrees(broken(truth)), '--', color='black', linewidth=1.0, label='truth')
        error.plot(time - start, np.degrees(wrap(log.fused['azimuth'] - truth)), color='#1f4fd8', linewidth=0.8)
        sigma = 2.0 * np.degrees(log.fused['sigma'])
        error.fill_between(time - start, -sigma, sigma, color='#1f4fd8', alpha=0.15, linewidth=0)
    error.set(xlabel='time (s)', ylabel='error (deg)', ylim=(-15, 15))
    bearing.set(ylabel="azimuth in the rig's frame (deg)", ylim=(-185, 185), yticks=range(-180, 181, 45), title=title)
    bearing.grid(alpha=0.3)
    error.grid(alpha=0.3)
    bearing.legend(loc='upper right', ncol=4, markerscale=3)
    figure.savefig(path, dpi=110, format='png')


def shade(axes: Sequence[Axes], time: NDArray, state: NDArray) -> None:
    """Shade the background by the state of the track; the legend of the first axes names the colours.

    Parameters:
        axes: that share one time axis.
        time (n, s): on this axis.
        state (n,): of the track at these times, values of `State`.
    """
    if not len(time):
        return
    edges, named = [0, *(np.flatnonzero(np.diff(state)) + 1), len(state) - 1], set()
    for begin, end in pairwise(edges):
        if state[begin] in SHADES:
            colour, name = SHADES[State(int(state[begin]))]
            for number, axis in enumerate(axes):
                axis.axvspan(time[begin], time[end], color=colour, linewidth=0, zorder=0,
                             label=name if not number and name not in named else None)
            named.add(name)


def broken(azimuth: NDArray) -> NDArray:
    """An azimuth (n, rad) with nan after each wrap, so that no line is drawn across the plot."""
    curve = np.array(wrap(azimuth), float)
    curve[1:][np.abs(np.diff(curve)) > np.pi] = np.nan
    return curve
