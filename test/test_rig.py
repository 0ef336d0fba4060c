"""The whole rig under `ros2 launch`, fed by the built-in simulator."""

from __future__ import annotations

import random
import socket
import time

import pytest
from machine_load import skip_figures_where_overloaded
from rig_process import RigProcess
from udp_ports import free_offset

pytestmark = pytest.mark.system


@pytest.fixture
def port_offset():
    """An offset of all UDP ports, so that runs do not meet."""
    return free_offset()


def test_without_a_simulator_the_rig_says_what_is_missing(port_offset):
    """No data arrives: no hang, no crash; the status names the missing topics."""
    rig = RigProcess('source:=udp', 'duration:=5', f'port_offset:={port_offset}')
    assert rig.finish() == 0, rig.output
    assert 'no target' in rig.output and 'no doa, detections, odometry' in rig.output
    assert not rig.leftovers()


@pytest.mark.parametrize(('node', 'complaint'), [('doa_node', 'no doa'), ('bridge_node', 'no detections')])
def test_one_modality_suffices_for_a_bearing(node, complaint, port_offset, tmp_path):
    """Without sound or without images, the other modality provides the bearing."""
    parameters = tmp_path / 'elsewhere.yaml'
    silent = {'doa_node': 'autostart: false', 'bridge_node': 'oracle_detections: false'}[node]
    parameters.write_text(f'/**/{node}:\n  ros__parameters:\n    {silent}\n')
    rig = RigProcess('scenario:=circle', 'oracle:=true', f'params:={parameters}', f'port_offset:={port_offset}')
    rig.wait_for(complaint)
    rig.wait_for(r'deg \+-')
    rig.interrupt()
    rig.finish(timeout=60.0)
    assert not rig.leftovers()


def test_garbage_on_every_port_is_survived_and_ctrl_c_ends_everything(port_offset):
    """Random bytes, empty, short and oversized datagrams on all ports of the bridge; then an interrupt prints the table."""
    rig = RigProcess('oracle:=true', f'port_offset:={port_offset}')
    rig.wait_for(r'deg \+-')
    chaos, sender = random.Random(4), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        for port in (9999, 20005, 28003, 30101, 30103, 31000):
            size = chaos.choice([0, 1, 3, 7, 24, 32, 112, 168, 1000, 65000])
            sender.sendto(chaos.randbytes(size), ('127.0.0.1', port + port_offset))
        time.sleep(0.05)
    rig.interrupt()
    rig.finish(timeout=60.0)
    assert 'coverage' in rig.output and 'restart 1' not in rig.output, rig.output
    assert not rig.leftovers()
    skip_figures_where_overloaded()
    assert rig.value('coverage') > 70.0
