"""The systemd unit of the rig: valid, restrictive, and with a command that starts the launch file."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / 'config' / 'systemd'
LAUNCH_FILE = Path(__file__).parents[1] / 'launch' / 'rig.launch.py'
MOST_EXPOSED = 4.0    # of 10, by `systemd-analyze security`


def analyze(*arguments):
    """Run systemd-analyze; returns exit code and output."""
    if shutil.which('systemd-analyze') is None:
        pytest.skip('systemd-analyze is not installed (Debian: apt install systemd)')
    result = subprocess.run(['systemd-analyze', *arguments], capture_output=True, text=True, timeout=60.0, check=False)
    return result.returncode, result.stdout + result.stderr


@pytest.fixture
def unit(tmp_path):
    """An instance of the template."""
    return shutil.copy(FOLDER / 'rig@.service', tmp_path / 'rig@left.service')


def settings():
    """NAME=VALUE of the example of an environment file."""
    lines = (FOLDER / 'rig.env').read_text().splitlines()
    return dict(line.split('=', 1) for line in lines if line and not line.startswith('#'))


def test_the_unit_is_valid(unit):
    """Unknown keys and sections are reported on lines of their own, with exit code 0 in some versions."""
    assert analyze('verify', str(unit)) == (0, '')


def test_the_unit_is_restrictive(unit):
    code, output = analyze('security', '--offline=true', str(unit))
    if 'unrecognized option' in output:
        pytest.skip('systemd older than version 250 cannot judge a file')
    exposure = float(re.search(r'exposure level for \S+ ([\d.]+)', output).group(1))
    assert code == 0 and exposure < MOST_EXPOSED, output


def test_the_command_passes_on_the_arguments(tmp_path):
    """The shell of the unit sources the workspace and replaces itself by the launch, with each argument a word."""
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(FOLDER / 'rig@.service')
    program, option, script = re.fullmatch(r"(\S+) (\S+) '(.*)'", unit['Service']['ExecStart']).groups()
    (tmp_path / 'ros2').write_text('#!/bin/sh\nprintf "%s\\n" "$$" "$@"\n')
    (tmp_path / 'ros2').chmod(0o755)
    (tmp_path / 'setup.bash').write_text(f'export PATH={tmp_path}:$PATH\n')
    environment = {**os.environ, 'RIG_SETUP': str(tmp_path / 'setup.bash'), 'RIG_ARGUMENTS': 'source:=udp port_offset:=250'}
    with subprocess.Popen([program, option, script.replace('$$', '$')], env=environment, stdout=subprocess.PIPE,
                          text=True) as process:
        number, *words = process.communicate(timeout=60.0)[0].split('\n')
    assert int(number) == process.pid
    assert words[:-1] == ['launch', '--noninteractive', 'av_fusion', 'rig.launch.py', 'source:=udp', 'port_offset:=250']


def test_the_example_names_arguments_of_the_launch_file():
    assert {'RIG_SETUP', 'RIG_ARGUMENTS'} <= set(settings())
    text = LAUNCH_FILE.read_text() + (Path(__file__).parents[1] / 'src/av_bringup/av_bringup/launching.py').read_text()
    for argument in settings()['RIG_ARGUMENTS'].split():
        assert f"'{argument.partition(':=')[0]}': (" in text
