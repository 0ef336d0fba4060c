"""px4_node against the fake autopilot, on PX4's topics: what process and graph add to the stage (test_good_guest.py)."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
from fake_vehicle import FakeVehicle

pytestmark = pytest.mark.system
OWN = [1, 191]


@pytest.fixture
def vehicle(request):
    """A fake of the firmware asked for, 1.16 by default: it obeys setpoints in any mode."""
    started = FakeVehicle(getattr(request, 'param', '1.16'))
    yield started
    started.close()


def degrees(state):
    """Pan (left) and tilt (up) in deg, where the fake's gimbal looks."""
    return -math.degrees(state['gimbal'][1]), math.degrees(state['gimbal'][0])


def looks(pan, tilt):
    return lambda state: abs(degrees(state)[0] - pan) < 0.5 and abs(degrees(state)[1] - tilt) < 0.5


def offered(state):
    return state['heartbeats'] > 100


@pytest.mark.parametrize('vehicle', ['1.14', '1.16', '1.18'], indirect=True)
def test_gimbal_and_body_in_all_quadrants(vehicle):
    """To the left is to the left; nothing leaves before the pilot hands over, and when he has what is his; all is given back.

    The oldest firmware, which has no modes and tells no layouts, the one that obeys in any mode, and the newest.
    """
    firmware_1_14, full = vehicle.firmware == '1.14', vehicle.firmware == '1.16'
    node = vehicle.node(offboard='true', **({'gimbal.need_ack': 'false'} if firmware_1_14 else {}))
    for pan, tilt in ((40.0, 25.0), (-130.0, -20.0), (130.0, 25.0), (-40.0, -20.0))[:4 if full else 2]:
        vehicle.tell(point={'pan': math.radians(pan), 'tilt': math.radians(tilt), 'yaw_rate': 0.3 * math.copysign(1, pan)})
        vehicle.wait(looks(pan, tilt), why=f'gimbal at {pan}, {tilt}')
    state = vehicle.wait(offered)
    assert state['setpoints'] == 0 and state['owner'] == OWN and state['denied'] == 0
    assert set(state['commands']) == {'1000', '1001'}
    modes = [14] if firmware_1_14 else [14, vehicle.wait(lambda state: state['modes'])['modes']['0'][1]]
    for mode in modes:
        vehicle.tell(pilot=mode)
        vehicle.wait(lambda state, mode=mode: state['nav_state'] == mode, why='mode selected')
        for rate in (0.3, -0.3):   # to the left is counter-clockwise: the heading, clockwise from north, falls
            vehicle.tell(point={'yaw_rate': rate, 'pan': rate})
            vehicle.wait(lambda state, rate=rate: abs(state['yaw_rate'] + rate) < 0.01, why=f'turning at {rate} rad/s')
        vehicle.tell(point={'yaw_rate': 0.3, 'mode': 0})
        vehicle.wait(lambda state: state['yaw_rate'] == 0.0, why='hold')
        vehicle.tell(pilot=4)
        vehicle.wait(lambda state: state['nav_state'] == 4)
    vehicle.stop_node(node)
    state = vehicle.wait(lambda state: state['owner'] is None and not state['modes'], why='gimbal and mode given back')
    assert not [event for event in state['events'] if event.startswith('a setpoint')] and state['foreign'] == 0


@pytest.mark.parametrize('vehicle', ['1.18'], indirect=True)
def test_beside_a_users_program_in_offboard_nothing_is_sent(vehicle):
    """Whatever the rig was asked for; it says who steers."""
    vehicle.tell(program={'speed': 2.0}, point={'yaw_rate': 0.4, 'pan': 0.2})
    vehicle.wait(lambda state: state['nav_state'] == 4)
    vehicle.node(offboard='true')
    vehicle.wait(looks(math.degrees(0.2), 0.0), why='the gimbal is pointed all the same')
    vehicle.tell(pilot=14)
    state = vehicle.wait(lambda state: state['speed'] > 1.9, why='at its speed')
    assert '/path_follower publishes /fmu/in/offboard_control_mode' in state['said']['state']
    vehicle.tell(program={'speed': 2.0, 'sends': False}, pilot=None)
    state = vehicle.wait(lambda state: state['failsafe'] and state['nav_state'] == 5, why='PX4 notices')
    assert state['setpoints'] == state['heartbeats'] == 0


def test_after_a_crash_in_offboard_the_pilot_decides(vehicle, tmp_path):
    """Killed and started again: the vehicle returns, and turns again once it has been handed over again."""
    vehicle.tell(point={'yaw_rate': 0.4, 'pan': 0.2}, pilot=14)
    node = vehicle.node({'AV_RIG_RUN': str(tmp_path)}, offboard='true')
    vehicle.wait(lambda state: state['yaw_rate'] < -0.3, why='turning')
    vehicle.tell(pilot=None)
    vehicle.kill_node(node)
    vehicle.wait(lambda state: state['failsafe'], why='failsafe')
    sent = vehicle.state['heartbeats'], vehicle.state['setpoints']
    vehicle.node({'AV_RIG_RUN': str(tmp_path), 'AV_RIG_RESTARTS': '1'}, offboard='true')
    vehicle.wait(lambda state: 'select another mode first' in state['said'].get('state', ''), why='waits for the pilot')
    start = vehicle.state['time']
    state = vehicle.wait(lambda state: state['time'] > start + 1.5)
    assert state['nav_state'] == 5 and (state['heartbeats'], state['setpoints']) == sent
    vehicle.tell(pilot=2)
    vehicle.wait(lambda state: state['nav_state'] == 2)
    vehicle.tell(pilot=14)
    vehicle.wait(lambda state: state['yaw_rate'] < -0.3, why='turning again')


def test_fields_of_another_firmware_are_not_decoded():
    """px4_msgs of 1.16, and a firmware that says of its messages without a version what 1.15 would."""
    vehicle = FakeVehicle('1.16', '--told', '1.15')
    try:
        vehicle.tell(point={'yaw_rate': 0.4, 'pan': 0.2}, pilot=14)
        vehicle.node(offboard='true')
        vehicle.wait(lambda state: 'out/vehicle_local_position is not used: the fields of VehicleLocalPosition'
                     in state['said'].get('diagnostics', ''), why='named')
        vehicle.wait(lambda state: state['odometry'] is not None, why='what is the same is used')
        assert vehicle.state['heartbeats'] == vehicle.state['setpoints'] == 0
    finally:
        vehicle.close()


def test_what_px4_says_is_what_the_rig_hears(vehicle):
    """Speeds of motors; and an odometry that is continuous although PX4's heading jumps by 40 deg."""
    vehicle.node()
    before = vehicle.wait(lambda state: state['odometry'] is not None)['odometry']
    assert before == pytest.approx(math.pi / 2 - vehicle.state['heading'], abs=0.01)
    vehicle.wait(lambda state: vehicle.tell(esc_rpm=[3000, 6000]) or state['said'].get('motors'), why='motor_speeds')
    assert vehicle.state['said']['motors'] == pytest.approx([100.0 * math.pi, 200.0 * math.pi])
    vehicle.tell(reset_heading=math.radians(40.0))
    start = vehicle.state['time']
    vehicle.wait(lambda state: state['time'] > start + 0.5)
    assert vehicle.state['odometry'] == pytest.approx(before, abs=0.01)


@pytest.fixture
def stale():
    """A vehicle of 1.16 behind an agent that still offers topics of 1.17 and later."""
    started = FakeVehicle('1.16', '--stale', 'vehicle_local_position_v1', 'vehicle_status_v4', 'vehicle_command_ack_v1')
    yield started
    started.close()


def test_topics_of_another_firmware_do_not_matter_unless_they_are_those_that_send(stale):
    stale.node(offboard='true')
    stale.tell(point={'pan': 0.2, 'yaw_rate': 0.3})
    stale.wait(lambda state: offered(state) and looks(math.degrees(0.2), 0.0)(state))
    stale.wait(lambda state: 'diagnostics' in state['said'])
    assert 'px4_msgs' not in stale.state['said']['diagnostics']
    stale.tell(speak={'vehicle_local_position': 'vehicle_local_position_v1'})
    stale.wait(lambda state: '/fmu/out/vehicle_local_position_v1 is version 1' in state['said']['diagnostics']
               and 'is silent' in state['said']['diagnostics'], why='the version that sends is named')
    stale.wait(lambda state: 'OFFBOARD is not offered: no fresh position' in state['said']['state'])
    stale.tell(speak={})
    stale.wait(lambda state: 'px4_msgs' not in state['said']['diagnostics'] and 'not offered' not in state['said']['state'])


def test_the_external_mode_is_registered_once_though_the_node_is_killed(vehicle, tmp_path):
    """And started again, in flight: PX4 forgets nothing while armed."""
    node = vehicle.node({'AV_RIG_RUN': str(tmp_path)})
    start = vehicle.wait(lambda state: state['modes'])['time']
    vehicle.wait(lambda state: state['time'] > start + 0.5)
    vehicle.kill_node(node)
    vehicle.node({'AV_RIG_RUN': str(tmp_path), 'AV_RIG_RESTARTS': '1'})
    vehicle.wait(lambda state: not state['modes'], why='the former registration ended')
    vehicle.wait(lambda state: state['modes'], why='registered again')
    assert vehicle.state['most_modes'] == 1 and list(vehicle.state['modes'].values()) == [['AV Track', 23]]


def test_without_px4_msgs_it_says_what_to_install():
    """The node stays alive, and its error message names the package and the branch."""
    process = subprocess.Popen([sys.executable, '-c', 'from av_px4.nodes.px4_node import main; main()'],
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        line = next(line for line in process.stdout if 'px4_msgs' in line)
        assert 'https://github.com/PX4/px4_msgs' in line and process.poll() is None
    finally:
        process.kill()
        process.communicate()
