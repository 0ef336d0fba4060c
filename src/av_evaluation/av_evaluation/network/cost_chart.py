"""The figure of the cost of a network by its number of rigs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter


def draw_cost(rigs: Sequence[int], shares: Sequence[float], targets: int, path: Path) -> None:
    """Plot the processor time by number of rigs.

    Parameters:
        rigs (n,): numbers of rigs.
        shares (n,): processor time over real time.
        targets: their number.
        path: of the picture.
    """
    figure = Figure(figsize=(6, 4), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.loglog(rigs, [100.0 * share for share in shares], 'o-', label=f'{targets} targets, 4 reports a second')
    axes.axhline(100.0, color='0.5', linestyle='--', label='one core')
    axes.set_xticks(rigs)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(ScalarFormatter())
    axes.minorticks_off()
    axes.set_xlabel('rigs')
    axes.set_ylabel('processor time (% of one core)')
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)
