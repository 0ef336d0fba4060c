"""Every node of the suite through its lifecycle, over and over: nothing is left behind."""

from __future__ import annotations

import importlib
import sys
import threading
from pathlib import Path
from types import ModuleType

import numpy as np
import psutil
import pytest
import rclpy
import soundfile
from bag_messages import flight
from rclpy.lifecycle import TransitionCallbackReturn
from ros_domains import free_domain
from udp_ports import free_offset

from av_common.node import RigNode

pytestmark = pytest.mark.system
ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(f'{file.parents[1].name}.nodes.{file.stem}' for file in ROOT.glob('src/*/*/nodes/*_node.py'))
CYCLES = 15
RIG = ROOT / 'config' / 'rig.yaml'
ARRAY = ROOT / 'config' / 'arrays' / 'two_microphones.yaml'


def parameters(node: str, folder: Path) -> dict[str, object]:
    """What a node needs to become active."""
    sound = folder / 'sound.wav'
    soundfile.write(sound, np.zeros((4800, 2)), 48000)
    return {
        'audio_node': {'file': sound},
        'bridge_node': {'rig_file': RIG, 'port_offset': free_offset()},
        'camera_node': {'file': ROOT / 'docs' / 'images' / 'demo.png'},
        'detector_node': {'threads': 1},
        'doa_node': {'array_file': ARRAY},
        'network_node': {'rigs': '[left, right]', 'positions': '[0.0, 0.0, 0.0, 40.0, 0.0, 0.0]'},
        'player_node': {'bag': folder / 'flight.mcap', 'only': 'all'},
        'recorder_node': {'path': folder / 'bag-%f.mcap'},
        'report_node': {'cot.url': 'udp://127.0.0.1:9', 'sapient.peer': '127.0.0.1:9'},
        'view_node': {'port': 0},
        'rig_frames_node': {'rig_file': ROOT / 'config' / 'rig_gimbal.yaml'},
    }.get(node, {})


def made(module: str, folder: Path) -> RigNode:
    """A node of a module that starts nothing by itself."""
    name = module.rpartition('.')[2]
    if name == 'player_node':
        flight(folder / 'flight.mcap', duration=1.0)
    given = {'autostart': 'false', **parameters(name, folder)}
    rclpy.init(args=['--ros-args', *(word for key, value in given.items() for word in ('-p', f'{key}:={value}'))],
               domain_id=free_domain())
    kinds = vars(importlib.import_module(module)).values()
    return next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, RigNode)
                and kind.__module__ == module)()


def left(node: RigNode) -> tuple[int, int, int]:
    """Numbers of entities, threads and file descriptors."""
    return len(node.entities()), threading.active_count(), psutil.Process().num_fds()


@pytest.mark.parametrize('module', MODULES)
def test_cycles_leave_nothing_behind(module, tmp_path, monkeypatch):
    """Entities, threads and descriptors do not grow with the cycles; the middleware may open one descriptor at any time."""
    if module.endswith('px4_node'):  # without messages there are no topics of PX4; the node's own remain
        monkeypatch.setitem(sys.modules, 'px4_msgs', ModuleType('px4_msgs'))
        monkeypatch.setitem(sys.modules, 'px4_msgs.msg', ModuleType('px4_msgs.msg'))
    node = made(module, tmp_path)
    try:
        counts = []
        for _ in range(CYCLES):
            for step in (node.trigger_configure, node.trigger_activate, node.trigger_deactivate, node.trigger_cleanup):
                assert step() == TransitionCallbackReturn.SUCCESS, node._problem
            counts.append(left(node))
        assert np.all(np.subtract(counts[-1], counts[1]) <= (0, 0, 1)), counts
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
