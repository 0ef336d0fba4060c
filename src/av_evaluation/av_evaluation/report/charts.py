"""Charts of results: bearings and errors against time, with the state of the track, and distributions of errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.metrics.results import RunResult, errors_together
from av_evaluation.report.text import label

COLOURS = {'fused': '#1f4fd8', 'sound': '#d98200', 'sight': '#1a7f37', 'gated': '#a3258f', 'kalman': '#c0392b',
           'moving_average': '#7a6a00', 'gcc_phat': '#5b6673', 'music': '#008b8b', 'mvdr': '#8c564b'}
SHADES = {State.VISUAL_ACTIVE: ('#cfe8cf', 'sight leads'), State.ACOUSTIC_ACTIVE: ('#fbe3c0', 'sound leads'),
          State.COASTING: ('#e0e0e0', 'coasting')}


def shade(axes: Axes, time: NDArray, state: NDArray) -> None:
    """Shade the background by the state (n,) of the track at times (n, s); the legend names the colours."""
    for value, (shade_, name) in SHADES.items():
        if np.any(state == value):
            axes.fill_between(time, 0.0, 1.0, state == value, step='post', color=shade_, linewidth=0, zorder=0,
                              transform=axes.get_xaxis_transform(), label=name)


def broken(azimuth: NDArray) -> NDArray:
    """An azimuth (n, rad) with nan after each wrap, so that no line is drawn across the plot."""
    curve = np.array(wrap(azimuth), float)
    curve[1:][np.abs(np.diff(curve)) > np.pi] = np.nan
    return curve


def colour(method: str) -> str:
    """Colour of a method in figures; of those of other packages one of matplotlib's ten."""
    return COLOURS.get(method, f'C{sum(map(ord, method)) % 10}')


def bearing_chart(run: RunResult) -> Figure:
    """Azimuth in the body frame and error against time with 2 sigma of the track, over shades of the track's state.

    Of sound, sight and fused those that the run has are drawn; the axis of errors spans 98 % of them.
    """
    figure = Figure(figsize=(11, 5.6), layout='constrained')
    bearing, error = figure.subplots(2, 1, sharex=True, gridspec_kw={'height_ratios': [5, 2]})
    start = float(run.truth['time'][0]) if run.truth else min(
        [float(result.time[0]) for result in run.methods.values() if len(result.time)], default=0.0)
    for axes in (bearing, error):
        shade(axes, run.state['time'] - start, run.state['state'])
    errors = [np.ones(1)]
    if run.truth:
        bearing.plot(run.truth['time'] - start, np.degrees(broken(run.truth['azimuth'])), '--', color='black', linewidth=1.1,
                     label='truth', zorder=3)
    for method in (method for method in ('sound', 'sight', 'fused') if method in run.methods):
        result, line = run.methods[method], method == 'fused'
        style = {'linewidth': 1.3} if line else {'linestyle': '', 'marker': '.', 'markersize': 3.0, 'alpha': 0.7}
        values = np.degrees(broken(result.azimuth) if line else wrap(result.azimuth))
        bearing.plot(result.time - start, values, color=colour(method), label=label(method), **style)
        error.plot(result.error_time - start, result.error_deg, color=colour(method), **style)
        errors.append(np.abs(result.error_deg))
    sigma = 2.0 * np.degrees(run.state['sigma'])
    error.fill_between(run.state['time'] - start, -sigma, sigma, color=colour('fused'), alpha=0.12, linewidth=0)
    limit = 1.1 * float(np.quantile(np.concatenate(errors), 0.98))
    bearing.margins(x=0.01)
    error.set(xlabel='time (s)', ylabel='error (deg)', ylim=(-limit, limit))
    bearing.set(ylabel="azimuth in the\nrig's frame (deg)")
    bearing.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncol=7, frameon=False, markerscale=3)
    return _tidy(figure)


def distribution_chart(runs: Sequence[RunResult], methods: Sequence[str]) -> Figure:
    """Cumulative distribution of the absolute errors, one curve for each method.

    Parameters:
        runs: whose errors are pooled.
        methods: to plot; those without errors are left out.
    """
    figure = Figure(figsize=(11, 4.2), layout='constrained')
    axes = figure.subplots()
    for method in methods:
        error = np.sort(np.abs(errors_together(runs, method)))
        if len(error):
            axes.plot(np.maximum(error, 0.02), 100.0 * np.arange(1, len(error) + 1) / len(error), label=label(method),
                      color=colour(method), linewidth=2.2 if method == 'fused' else 1.3)
    axes.set(xscale='log', xlim=(0.02, 180.0), ylim=(0, 101), xlabel='error (deg)', ylabel='share of errors below (%)')
    axes.set_xticks([0.03, 0.1, 0.3, 1, 3, 10, 30, 100], ['0.03', '0.1', '0.3', '1', '3', '10', '30', '100'])
    axes.legend(*axes.get_legend_handles_labels(), loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False)
    return _tidy(figure)


def _tidy(figure: Figure) -> Figure:
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)
    return figure
