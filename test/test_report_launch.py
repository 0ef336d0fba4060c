"""Launch arguments of the node that reports targets: none starts nothing, each one names its peer."""

from __future__ import annotations

import importlib.util

import pytest

pytest.importorskip('launch_ros', reason='needs ROS 2')
from av_bringup import launching


def started(launch_file, **arguments):
    """Programs of the launch."""
    values = {name: default for name, (default, _, _) in launch_file.ARGUMENTS.items()} | {'source': 'hardware', **arguments}
    return [action.node_executable for action in launch_file.start(values) if hasattr(action, 'node_executable')]


@pytest.mark.parametrize('arguments', [{'sapient': '127.0.0.1:5020'}, {'cot': 'udp://239.2.3.1:6969'}, {'track_log': 'tracks'},
                                       {'sapient': '127.0.0.1:5020', 'cot': 'udp://239.2.3.1:6969'}])
def test_each_argument_starts_the_node_and_none_does_not(launch_file, monkeypatch, tmp_path, arguments):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name: name)
    assert 'report_node' not in started(launch_file)
    assert started(launch_file, **arguments).count('report_node') == 1


def test_a_missing_library_is_named(launch_file, monkeypatch):
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(launching.MissingPackageError, match=r'needs the package sapient-msg.*pip install sapient-msg'):
        started(launch_file, sapient='127.0.0.1:5020')
