"""Fixtures of the tests of the whole rig."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from rig_process import RigProcess


@pytest.fixture(autouse=True)
def leave_nothing_running():
    """Kill all processes that a test started when it ends."""
    yield
    while RigProcess.running:
        RigProcess.running.pop().kill()


@pytest.fixture(scope='module')
def launch_file():
    """The rig's launch file as a module."""
    specification = importlib.util.spec_from_file_location('rig_launch', Path(__file__).parents[1] / 'launch' / 'rig.launch.py')
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module
