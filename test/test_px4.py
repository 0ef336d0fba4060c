"""The whole rig with a fake PX4, as the tutorials say, command by command: stand-ins for PX4 obey what is typed."""

from __future__ import annotations

import math
import re
import subprocess
from pathlib import Path

import pytest
from fake_vehicle import FakeVehicle, stand_ins
from px4_layouts import overlay
from rig_process import RigProcess
from ros_domains import free_domain
from tutorials import tool
from udp_ports import free_offset

pytestmark = pytest.mark.system
TUTORIALS = Path(__file__).resolve().parents[1] / 'docs' / 'tutorials'
OWN_MODE = 23


class Walk:
    """The commands of a page, in the folder of a PX4 that stands in for the real one."""

    def __init__(self, page, folder, firmware, domain):
        self.text, self.folder = (TUTORIALS / page).read_text(), stand_ins(folder, firmware)
        self.commands = [command.partition('  #')[0].strip() for command in tool('commands').commands(TUTORIALS / page)]
        self.firmware, self.domain, self.vehicles = firmware, domain, []

    def typed(self, pattern):
        """The commands that a pattern describes, which are walked by this; none is an error."""
        found = [command for command in self.commands if re.search(pattern, command)]
        assert found, (pattern, self.commands)
        self.commands = [command for command in self.commands if command not in found]
        return found

    def vehicle(self, command, namespace=''):
        """What the command starts."""
        self.vehicles.append(FakeVehicle(self.firmware, domain=self.domain, namespace=namespace, typed=command,
                                         folder=self.folder))
        return self.vehicles[-1]

    def run(self, command, seconds=60.0):
        """Type a command, to its end; returns what it printed."""
        done = subprocess.run(['bash', '-c', command], cwd=self.folder, env=self.vehicles[0].environment | {
            'PATH': f'{self.folder}:{self.vehicles[0].environment["PATH"]}'}, text=True, capture_output=True, timeout=seconds,
            check=False)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout

    def close(self):
        """End the vehicles."""
        for vehicle in self.vehicles:
            vehicle.close()


@pytest.fixture
def walk(tmp_path):
    """Begin to walk a page."""
    walks = []

    def start(page, firmware, domain):
        walks.append(Walk(page, tmp_path, firmware, domain))
        return walks[-1]
    yield start
    for each in walks:
        each.close()


def offered(state):
    """Whether the rig's mode can be selected."""
    return state['modes'] and 'cannot run' not in state['said'].get('state', 'cannot run')


def test_the_first_flight(walk, monkeypatch):
    """Behind, in fog, with sound only: in "AV Track" the body turns, front and back are resolved, the body faces the drone."""
    for name, value in overlay('1.16').items():
        monkeypatch.setenv(name, value)
    domain = free_domain()
    page = walk('fly.md', '1.16', domain)
    vehicle = page.vehicle(page.typed('make px4_sitl')[0])
    assert page.typed('^MicroXRCEAgent') == ['MicroXRCEAgent udp4 -p 8888']
    simulated, with_hardware = page.typed('^ros2 launch')
    assert 'source:=hardware' in with_hardware    # its arguments: test_documents.py
    rig = RigProcess(*simulated.split()[4:], 'oracle:=true', f'port_offset:={free_offset()}', domain=domain)
    vehicle.wait(offered, 90.0, 'offered its mode')
    (enable,), (echo,) = page.typed('^ros2 service call'), page.typed('^ros2 topic echo')
    assert 'success=True' in page.run(enable)
    heading = vehicle.state['heading']
    for command in re.findall(r'`(commander [^`]+)`', page.text)[:2]:
        vehicle.type(command)
    vehicle.wait(lambda state: state['nav_state'] == OWN_MODE, 30.0, 'in its mode')
    rig.wait_for(r'front +\d+ % resolved', 120.0)
    turned = abs(math.remainder(vehicle.state['heading'] - heading, 2.0 * math.pi))
    assert turned > math.radians(10.0), rig.output
    # The drone hovers in the west.
    vehicle.wait(lambda state: abs(math.remainder(state['heading'] + math.pi / 2.0, 2.0 * math.pi)) < math.radians(45.0),
                 40.0, 'facing the drone')
    assert vehicle.state['foreign'] == 0 and vehicle.state['largest_rate'] <= math.radians(30.0) + 1e-6
    assert vehicle.state['heartbeats'] == 0 and set(vehicle.state['commands']) == {'1000', '1001'}
    shown = page.run(echo.replace('echo', 'echo --once'))    # what the body does changes at any moment
    assert 'name: px4' in shown and 'key: body' in shown
    assert not page.commands, 'commands of the page that nobody walked'
    rig.interrupt()
    rig.finish()
    state = vehicle.wait(lambda state: state['owner'] is None and state['nav_state'] == 4, why='gimbal given back, Hold')
    assert not state['failsafe'] and not rig.leftovers()


def test_two_vehicles(walk):
    """In their namespaces, with their ids: each has its gimbal, its mode, its pilot, and its own program that it yields to.

    In place of each rig its px4_node, in the namespace that the launch is told (two whole rigs: test_second_rig.py).
    """
    page = walk('two_vehicles.md', '1.16', free_domain())
    launches = page.typed('^ros2 launch')
    spaces = [re.search(r'namespace:=(\w+)', command)[1] for command in launches]
    vehicles = {space: page.vehicle(command, space) for space, command in zip(spaces, page.typed('bin/px4 -i'), strict=True)}
    assert page.typed('^MicroXRCEAgent') == ['MicroXRCEAgent udp4 -p 8888'] and 'port_offset:=' in launches[1]
    for sign, vehicle in zip((1.0, -1.0), vehicles.values(), strict=True):
        vehicle.tell(point={'pan': 0.5 * sign, 'yaw_rate': 0.3 * sign})
        vehicle.node()
    for number, vehicle in enumerate(vehicles.values(), 2):
        vehicle.wait(lambda state, own=[number, 191]: offered(state) and state['owner'] == own, why=f'the mode of {number}')
    for command in page.typed('px4-commander'):
        instance, line = page.run(command).split(maxsplit=1)
        vehicles[f'px4_{instance}'].type(line.strip())
    first, second = vehicles.values()
    first.wait(lambda state: state['yaw_rate'] < -0.25, why='the first turns left')
    assert second.state['nav_state'] == 4 and second.state['setpoints'] == 0    # its pilot has not taken off
    for line in ('commander takeoff', 'commander mode ext1'):
        second.type(line)
    first.tell(program={'speed': 0.0, 'sends': False})
    second.wait(lambda state: state['yaw_rate'] > 0.25, why='the second turns right')
    first.wait(lambda state: 'path_follower publishes' in state['said']['state'], why='silenced')
    assert 'path_follower' not in second.state['said']['state'] and second.state['nav_state'] == OWN_MODE
    (echo,) = page.typed('^ros2 topic echo')
    assert 'path_follower' in page.run(echo.replace('echo', 'echo --once'))
    assert not page.commands, 'commands of the page that nobody walked'


def test_without_px4_msgs_the_launch_says_what_to_install():
    """`px4:=true` ends at once, with the package, its branch and the documentation page."""
    rig = RigProcess('px4:=true')
    assert rig.finish(timeout=60.0) != 0
    assert 'https://github.com/PX4/px4_msgs' in rig.output and 'docs/guides/px4.md' in rig.output
    assert not rig.leftovers()
