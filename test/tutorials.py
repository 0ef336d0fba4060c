"""Commands of the tutorials, as their tests type them."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import subprocess
import time
from pathlib import Path

PROJECT = Path(__file__).parents[1]
STAND_INS = Path(__file__).parent / 'stand_ins'  # for hardware


def tool(name):
    """A program of tools/lint as a module."""
    specification = importlib.util.spec_from_file_location(f'lint_{name}', PROJECT / 'tools' / 'lint' / f'{name}.py')
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def commands(page):
    """All commands of a tutorial, without what a shell starts with."""
    return [command for command in tool('commands').commands(PROJECT / 'docs/tutorials' / page)
            if not command.startswith(('. tools/ros_env.sh', '#'))]


def typed(page, pattern):
    """The one command of a tutorial that a pattern describes."""
    found = [command for command in commands(page) if re.search(pattern, command)]
    assert len(found) == 1, found
    return found[0]


def block(page, start):
    """The YAML of a tutorial that begins with a text."""
    return re.search(rf'```yaml\n({re.escape(start)}.*?)```', (PROJECT / 'docs/tutorials' / page).read_text(), re.DOTALL)[1]


def words(command):
    """Arguments of a command; of `make demo` those of its launch."""
    given = shlex.split(command, comments=True)
    return shlex.split(given[2].removeprefix('DEMO=')) if given[:2] == ['make', 'demo'] else given


def run(command, folder, typed_in='', **environment):
    """A command of a page, as typed in a folder; returns what it prints.

    Parameters:
        command: as in the page.
        folder: current one.
        typed_in: what a person types while it runs.
        environment: further variables.
    """
    done = subprocess.run(['bash', '-c', command], cwd=folder, capture_output=True, text=True, check=False, input=typed_in,
                          env={**os.environ, 'MPLBACKEND': 'agg', **environment})
    assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
    return done.stdout


def found(command, folder, **environment):
    """What a command prints that needs a running rig: again where it has not found that yet; fails after 20 s."""
    deadline = time.monotonic() + 20.0
    while True:
        left = max(deadline - time.monotonic(), 0.1)
        try:
            return run(f'timeout {left:.1f} {command}', folder, **environment)
        except AssertionError:
            if time.monotonic() > deadline - 0.5:
                raise
