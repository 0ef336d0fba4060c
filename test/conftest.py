"""Fixtures of the tests of the whole rig."""

from __future__ import annotations

import pytest
from rig_process import RigProcess


@pytest.fixture(autouse=True)
def leave_nothing_running():
    """Kill all processes that a test started when it ends."""
    yield
    while RigProcess.running:
        RigProcess.running.pop().kill()
