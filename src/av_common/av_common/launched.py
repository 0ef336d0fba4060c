"""What a launch file and its processes tell each other: the folder of the run, restarts, the end of a start, and heartbeats.

Without these variables of the environment a process was started by hand or by another program: it has no folder and counts
no restarts.
"""

from __future__ import annotations

import math
import os
import struct
import time
from contextlib import suppress
from pathlib import Path

RUN_FOLDER = 'AV_RIG_RUN'     # folder of files that outlive a process but not the launch; marks the launch's processes, too
RESTARTS = 'AV_RIG_RESTARTS'  # number of earlier processes of this launch that this one replaces
HUNG = 'AV_RIG_HUNG'          # of them, how many had hung
BEAT_PERIOD_S = 0.5           # a small part of the time after which a process counts as hung


def run_folder() -> Path | None:
    """The private folder of the launch that started this process; None without one."""
    folder = os.environ.get(RUN_FOLDER, '')
    return Path(folder) if folder else None


def restarts(count: str = RESTARTS) -> int:
    """How often the launch has restarted this process; 0 for the first, and without a launch. HUNG: because it had hung."""
    text = os.environ.get(count, '')
    return int(text) if text.isdecimal() else 0


def report_started() -> None:
    """Tell the launch that this process has started; a process that ends with an error before has failed to start."""
    folder = run_folder()
    if folder:
        with suppress(OSError):
            started_file(folder, os.getpid()).touch()


def beat(busy: bool = False) -> None:
    """Tell the launch that this process goes on; called by what would stand still if it hung, every BEAT_PERIOD_S.

    Parameters:
        busy: whether it begins something that may take long, such as to load a model.
    """
    folder = run_folder()
    if folder:
        with suppress(OSError):
            started_file(folder, os.getpid()).write_text(f'{"busy " if busy else ""}{time.monotonic():.3f}')


def started_file(folder: Path, process: int) -> Path:
    """The file that exists once a process has started, and holds its newest heartbeat; empty for one without.

    Parameters:
        folder: the folder of the run.
        process: id of the process.
    """
    return folder / f'{process}.started'


class KeptNumbers:
    """A few numbers that outlive the process of a node, but not the launch that started it.

    Parameters:
        name: name of their file in the folder of the run, unique in the launch.
        initial: the numbers in the first process.
        lost: those in a later one where what was kept cannot be read; None for `initial`.

    Attributes:
        values: the numbers that were kept last.
    """

    def __init__(self, name: str, initial: tuple[float, ...], lost: tuple[float, ...] | None = None) -> None:
        self._layout = struct.Struct(f'<{len(initial)}d')
        folder = run_folder()
        self._file: int | None = None
        with suppress(OSError):
            if folder:
                self._file = os.open(folder / name.strip('/').replace('/', '.'), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self.keep(*((self._kept() or lost or initial) if restarts() else initial))

    def keep(self, *values: float) -> None:
        """Keep numbers for the next process; cheap enough for every message."""
        self.values = values
        with suppress(OSError):
            if self._file is not None:
                os.pwrite(self._file, self._layout.pack(*values), 0)

    def _kept(self) -> tuple[float, ...] | None:
        data = b''
        with suppress(OSError):
            if self._file is not None:
                data = os.pread(self._file, self._layout.size + 1, 0)
        values = self._layout.unpack(data) if len(data) == self._layout.size else ()
        return values if values and all(map(math.isfinite, values)) else None
