"""The systemd unit of the rig: valid, restrictive, and with a command that starts the launch file."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from av_bringup.security.keystore import check_enclave

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


def test_the_example_keeps_dds_on_this_machine():
    """An installed ROS 2 looks for nodes in the whole subnet, where the variable is not set."""
    assert settings()['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'


def test_a_keystore_as_the_guide_copies_it_is_accepted_and_readable_by_the_group_alone(tmp_path):
    """By the commands of the guide, without sudo and change of the owner."""
    made, keys = tmp_path / 'keys', tmp_path / 'etc'
    subprocess.run(['ros2', 'run', 'av_bringup', 'security', '--keystore', str(made)], check=True, capture_output=True,
                   timeout=60.0)
    guide = (FOLDER.parents[1] / 'docs/guides/service.md').read_text()
    commands = re.findall(r'^sudo (rsync|chmod) (.*)$', guide, re.MULTILINE)
    assert [program for program, _ in commands] == ['rsync', 'chmod']
    if shutil.which('rsync') is None:
        shutil.copytree(made, keys, ignore=shutil.ignore_patterns('private'), symlinks=True)
        commands = commands[1:]
    for program, words in commands:
        told = words.replace(' keys/', f' {made}/').replace('/etc/rig/keys', str(keys)).split()
        subprocess.run([program, *told], check=True, timeout=20.0)
    check_enclave(keys, '/fusion_node')
    assert not (keys / 'private').exists()
    files = [path for path in keys.rglob('*') if not path.is_symlink()]
    assert files and all(path.stat().st_mode & 0o077 == (0o050 if path.is_dir() else 0o040) for path in files)
