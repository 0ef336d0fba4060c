"""pointing_node and px4_node in real time with a vehicle that answers as PX4 was flown, and bearings that are late."""

from __future__ import annotations

import math
import signal
import subprocess
import sys

import pytest
from fake_vehicle import FakeVehicle
from ros_domains import free_domain

pytestmark = pytest.mark.system
RATE = math.radians(25.0)


@pytest.fixture
def flight():
    """A vehicle in OFFBOARD that pointing turns, and its px4_node."""
    vehicle = FakeVehicle('1.16', '--pilot', '14', domain=free_domain())
    node = vehicle.node(offboard='true', **{'gimbal.enabled': 'false'})
    pointing = subprocess.Popen(
        [sys.executable, '-c', 'from av_pointing.nodes.pointing_node import main; main()', '--ros-args', '-p', 'enabled:=true',
         '-p', 'move_gimbal:=false'], env=vehicle.environment)
    try:
        vehicle.wait(lambda state: state['nav_state'] == 14, 60.0, 'offered OFFBOARD')
        yield vehicle, node
    finally:    # what a failure leaves running slows down all tests that follow
        pointing.kill()
        pointing.wait()
        vehicle.close()


@pytest.mark.parametrize('age', [0.1, 0.4])
def test_the_body_settles_on_a_moving_target_and_stops_when_it_is_lost(flight, age):
    """Angles only: where a loaded machine delays all processes, they hold later."""
    vehicle, _ = flight
    vehicle.tell(set={'loss_time': 10.0})
    vehicle.tell(target={'azimuth': 1.0, 'rate': 0.6 * RATE, 'age': age})
    state = vehicle.wait(lambda state: math.degrees(state['rms'] or math.inf) < 2.0, 120.0, 'settled')
    print(f"bearings {age} s old: {math.degrees(state['rms']):.2f} deg rms over 4 s")
    vehicle.tell(target=None)
    start = vehicle.state['time']
    state = vehicle.wait(lambda state: state['time'] > start + 2.0 and state['yaw_rate'] == 0.0, why='still')
    turned = abs(math.degrees(state['since_bearing']))
    print(f"turned by {turned:.1f} deg from 0.3 s after the newest bearing")
    assert state['nav_state'] == 14 and state['foreign'] == 0 and turned < 10.0


def test_a_killed_node_leaves_no_more_than_the_failsafe_lets_turn(flight):
    """From 25 deg/s: PX4 turns on for 1.0 s, then by 0.5 s of the rate."""
    vehicle, node = flight
    vehicle.tell(target={'azimuth': 0.0, 'rate': RATE, 'age': 0.1})
    vehicle.wait(lambda state: math.degrees(state['rms'] or math.inf) < 3.0, 120.0, 'settled')
    vehicle._nodes.remove(node)
    node.send_signal(signal.SIGKILL)
    node.communicate()
    state = vehicle.wait(lambda state: state['nav_state'] != 14 and state['yaw_rate'] == 0.0, why='failsafe')
    turned = abs(math.degrees(state['since_setpoint']))
    print(f'killed at 25 deg/s: turned by {turned:.1f} deg')
    assert 25.0 < turned < 30.0 * 1.6
