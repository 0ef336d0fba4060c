"""Chart of the memory of processes against time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from av_evaluation.runs.soak import ProcessHistory


def draw_memory(histories: Sequence[ProcessHistory], path: Path, settle: float) -> None:
    """Draw the resident memory of each process, and its change since it settled.

    Parameters:
        histories: of the processes.
        path: of the PNG.
        settle (s): as in `Limits`.
    """
    figure = Figure(figsize=(11, 7), layout='constrained')
    size, change = figure.subplots(2, 1, sharex=True)
    for history in histories:
        minutes, resident = np.array(history.times) / 60.0, history.column('resident')
        settled = history.settled(settle)
        size.plot(minutes, resident, label=f'{history.name} {history.process_id}', linewidth=1.3)
        change.plot(minutes[settled], resident[settled] - np.median(resident[settled][:5]), linewidth=1.3)
    size.set(ylabel='resident memory (MiB)', ylim=(0.0, None))
    change.set(ylabel=f'change since {settle / 60.0:g} min (MiB)', xlabel='time (min)')
    for axes in (size, change):
        axes.grid(alpha=0.25)
    size.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False)
    figure.savefig(path, dpi=110)
