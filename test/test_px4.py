"""The whole rig with a fake PX4: the launch file, the built-in simulator, and the vehicle that they turn."""

from __future__ import annotations

import math
import os
import re
import subprocess
from pathlib import Path

import pytest
from fake_vehicle import FakeVehicle
from px4_layouts import overlay
from rig_process import RigProcess
from udp_ports import free_offset

pytestmark = pytest.mark.system


@pytest.fixture
def fly(monkeypatch):
    """Start the rig with `px4:=true` and a vehicle of firmware 1.16 beside it."""
    vehicles = []

    def start(*arguments, options=()):
        for name, value in overlay('1.16').items():
            monkeypatch.setenv(name, value)
        rig = RigProcess('px4:=true', 'oracle:=true', 'enable_pointing:=true', f'port_offset:={free_offset()}', *arguments)
        vehicles.append(FakeVehicle('1.16', *options, domain=rig.domain))
        return rig, vehicles[-1]

    yield start
    for vehicle in vehicles:
        vehicle.close()


def tutorial(command):
    """The arguments of the first command of the tutorial that begins so."""
    page = (Path(__file__).resolve().parents[1] / 'docs' / 'tutorials' / 'fly.md').read_text()
    return re.search(rf'^{re.escape(command)} (.*)$', page, re.MULTILINE)[1].split()


def test_the_tutorial_in_simulation(fly):
    """Behind, in fog, with sound only: in "AV Track" the body turns, front and back are resolved, the body faces the drone."""
    rig, vehicle = fly(*(argument for argument in tutorial('ros2 launch av_fusion rig.launch.py')
                         if argument not in ('px4:=true', 'enable_pointing:=true')), options=['--pilot', '23'])
    heading = vehicle.wait(lambda state: state['nav_state'] == 23, 90.0, 'offered its mode')['heading']
    rig.wait_for(r'front +\d+ % resolved', 120.0)
    turned = abs(math.remainder(vehicle.state['heading'] - heading, 2.0 * math.pi))
    assert turned > math.radians(10.0), rig.output
    # The drone hovers in the west.
    vehicle.wait(lambda state: abs(math.remainder(state['heading'] + math.pi / 2.0, 2.0 * math.pi)) < math.radians(45.0),
                 40.0, 'facing the drone')
    assert vehicle.state['foreign'] == 0 and vehicle.state['largest_rate'] <= math.radians(30.0) + 1e-6
    assert vehicle.state['heartbeats'] == 0 and set(vehicle.state['commands']) == {'1000', '1001'}
    echo = subprocess.run(['ros2', 'topic', 'echo', '--once', *tutorial('ros2 topic echo')], text=True, capture_output=True,
                          timeout=60, env={**os.environ, 'ROS_DOMAIN_ID': str(rig.domain)}, check=False)
    # what the body does changes at any moment
    assert 'name: px4' in echo.stdout and 'key: body' in echo.stdout, echo.stdout + echo.stderr
    rig.interrupt()
    rig.finish()
    assert vehicle.wait(lambda state: state['owner'] is None, why='the gimbal given back')
    assert not rig.leftovers()


def test_without_px4_msgs_the_launch_says_what_to_install():
    """`px4:=true` ends at once, with the package, its branch and the documentation page."""
    rig = RigProcess('px4:=true')
    assert rig.finish(timeout=60.0) != 0
    assert 'https://github.com/PX4/px4_msgs' in rig.output and 'docs/guides/px4.md' in rig.output
    assert not rig.leftovers()
