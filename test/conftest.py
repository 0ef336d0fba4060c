"""What the tests of the whole rig share."""

from __future__ import annotations

import pytest
from rig_process import RigProcess


@pytest.fixture(autouse=True)
def leave_nothing_running():
    """Whatever a test started is killed when it ends."""
    yield
    while RigProcess.running:
        RigProcess.running.pop().kill()
