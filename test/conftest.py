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
    return loaded('rig')


@pytest.fixture(scope='module')
def network_file():
    """The network's launch file as a module."""
    return loaded('network')


@pytest.fixture(scope='module')
def replay_file():
    """The launch file of replays as a module."""
    return loaded('replay')


def loaded(name):
    """A launch file as a module."""
    file = Path(__file__).parents[1] / 'launch' / f'{name}.launch.py'
    specification = importlib.util.spec_from_file_location(f'{name}_launch', file)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module
