"""`make build` builds what has changed, and nothing else."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest


@pytest.fixture
def build(monkeypatch, tmp_path):
    """tools/build.py in a workspace of two packages, with a colcon that notes what it is asked to build."""
    specification = importlib.util.spec_from_file_location('build_tool', Path(__file__).parents[1] / 'tools' / 'build.py')
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    monkeypatch.setattr(module, 'PROJECT', tmp_path)
    monkeypatch.setattr(module, 'BUILT', tmp_path / 'build' / 'built.json')
    for name in ('one', 'two'):
        for file in ('package.xml', 'setup.py', f'{name}/module.py', f'{name}/node_parameters.yaml', 'test/test_it.py'):
            path = tmp_path / 'src' / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text('')
    program = tmp_path / 'bin' / 'colcon'
    program.parent.mkdir()
    program.write_text('#!/bin/sh\necho "$@" >> asked\nmkdir -p build\n[ ! -e broken ] || exit 1\n'
                       'for name in one two; do at=install/$name/share/$name; mkdir -p $at; touch $at/package.xml; done')
    program.chmod(0o755)
    monkeypatch.setenv('PATH', f'{program.parent}{os.pathsep}{os.environ["PATH"]}')

    def run():
        asked = tmp_path / 'asked'
        asked.unlink(missing_ok=True)
        code = module.main()
        return code, asked.read_text().split('--packages-select ')[1].split() if asked.exists() else []

    assert run() == (0, ['one', 'two'])
    return run


def test_nothing_is_built_where_nothing_changed(build):
    assert build() == (0, [])


@pytest.mark.parametrize('file', ['one/module.py', 'test/test_it.py'])
def test_what_a_module_or_a_test_says_needs_no_build(build, tmp_path, file):
    (tmp_path / 'src/one' / file).write_text('changed = True')
    assert build() == (0, [])


@pytest.mark.parametrize('file', ['one/new.py', 'one/node_parameters.yaml', 'setup.py', 'package.xml', 'launch/new.launch.py'])
def test_a_changed_package_is_built_once(build, tmp_path, file):
    path = tmp_path / 'src/one' / file
    path.parent.mkdir(exist_ok=True)
    path.write_text('changed')
    assert build() == (0, ['one'])
    assert build() == (0, [])


def test_a_removed_module_and_a_lost_installation_are_built(build, tmp_path):
    (tmp_path / 'src/two/two/module.py').unlink()
    assert build() == (0, ['two'])
    (tmp_path / 'install/one/share/one/package.xml').unlink()
    assert build() == (0, ['one'])


def test_what_failed_is_built_again(build, tmp_path):
    (tmp_path / 'src/one/setup.py').write_text('wrong')
    (tmp_path / 'broken').touch()
    assert build() == (1, ['one'])
    (tmp_path / 'broken').unlink()
    assert build() == (0, ['one'])


def test_another_ros_builds_all(build, monkeypatch):
    monkeypatch.setenv('ROS_DISTRO', 'other')
    assert build() == (0, ['one', 'two'])
