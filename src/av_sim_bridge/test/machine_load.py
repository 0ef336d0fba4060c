"""Detection of an overloaded machine, on which measured values of real-time tests say nothing about the rig."""

from __future__ import annotations

import os

import pytest

MOST_PER_CORE = 4.0    # the rig alone, with its simulator, keeps two to three processes busy


def slowness() -> float:
    """How many times longer than on a machine without other load a process waits for a core; at least 1."""
    return max(1.0, os.getloadavg()[0] / len(os.sched_getaffinity(0)))


def skip_figures_where_overloaded() -> None:
    """Skip the rest of a test where far more processes want to run than there are cores."""
    cores, wanted = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    if wanted > MOST_PER_CORE * cores:
        pytest.skip(f'{wanted:.0f} processes share {cores} cores: a run in real time has gaps that are not the rig\'s')
