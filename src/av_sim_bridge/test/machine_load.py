"""Detection of an overloaded machine, on which measured values of real-time tests say nothing about the rig."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

BUSY_PER_CORE = 1.5      # beside the rig and its simulator, something else runs
MOST_PER_CORE = 4.0      # the rig alone, with its simulator, keeps two to three processes busy
LONGEST_PAUSE_S = 0.3    # beyond it, inputs count as stale
MOST_STOLEN = 0.1        # share of processor time that a virtual machine does not get
PERIOD_S = 0.05


class LoadWatch:
    """What the machine is kept busy with while a `with` block runs: `pause_s`, `stolen` and `wanted` processes."""

    def __init__(self) -> None:
        self.pause_s = 0.0
        self._samples: list[int] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> LoadWatch:
        self._first = _processor_times()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        total, stolen = (now - before for now, before in zip(_processor_times(), self._first, strict=True))
        self.stolen = stolen / max(total, 1)

    def _watch(self) -> None:
        before = time.monotonic()
        while not self._end.wait(PERIOD_S):
            now = time.monotonic()
            self.pause_s = max(self.pause_s, now - before - PERIOD_S)
            running = Path('/proc/loadavg').read_text().split()[3].split('/')[0]
            self._samples.append(int(running) - 1)      # this thread runs, too
            before = time.monotonic()

    @property
    def wanted(self) -> float:
        """Mean number of processes that run or wait for a core."""
        return sum(self._samples) / max(len(self._samples), 1)

    @property
    def disturbed(self) -> bool:
        """Whether the machine had other work, or stood still for a while."""
        return self.wanted > BUSY_PER_CORE * _cores() or self.pause_s > LONGEST_PAUSE_S or self.stolen > MOST_STOLEN

    @property
    def overloaded(self) -> bool:
        """Whether far more processes wanted to run than there are cores. A pause does not show it: tests pause, too."""
        return self.wanted > MOST_PER_CORE * _cores()

    def __str__(self) -> str:
        return (f'{self.wanted:.1f} processes shared {_cores()} cores, the longest pause was {self.pause_s:.2f} s, '
                f'{100.0 * self.stolen:.0f} % of processor time was not given')


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _processor_times() -> tuple[int, int]:
    """Clock ticks of all cores since boot: all, and those given to other virtual machines (`steal`, see proc(5))."""
    ticks = [int(value) for value in Path('/proc/stat').read_text().splitlines()[0].split()[1:9]]
    return sum(ticks), ticks[7]


def slowness() -> float:
    """How many times longer than on a machine without other load a process waits for a core, within 1 and MOST_PER_CORE."""
    return min(max(1.0, os.getloadavg()[0] / _cores()), MOST_PER_CORE)


def skip_figures_where_overloaded() -> None:
    """Skip the rest of a test where far more processes want to run than there are cores."""
    cores, wanted = _cores(), os.getloadavg()[0]
    if wanted > MOST_PER_CORE * cores:
        pytest.skip(f'{wanted:.0f} processes share {cores} cores: a run in real time has gaps that are not the rig\'s')
