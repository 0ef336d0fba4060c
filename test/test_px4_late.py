"""pointing_node and px4_node in real time with a vehicle that answers as PX4 was flown, and bearings that are late."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
from fake_vehicle import FakeVehicle
from ros_domains import free_domain

pytestmark = pytest.mark.system
RATE = math.radians(15.0)


@pytest.fixture
def flight():
    """A vehicle in OFFBOARD that pointing turns."""
    vehicle = FakeVehicle('1.16', '--pilot', '14', domain=free_domain())
    vehicle.node(offboard='true', **{'gimbal.enabled': 'false'})
    pointing = subprocess.Popen(
        [sys.executable, '-c', 'from av_pointing.nodes.pointing_node import main; main()', '--ros-args', '-p', 'enabled:=true',
         '-p', 'move_gimbal:=false'], env=vehicle.environment)
    try:
        vehicle.wait(lambda state: state['nav_state'] == 14, why='offered OFFBOARD')
        yield vehicle
    finally:    # what a failure leaves running slows down all tests that follow
        pointing.kill()
        pointing.wait()
        vehicle.close()


def test_the_body_settles_on_a_moving_target_and_stops_when_it_is_lost(flight):
    """Bearings 0.4 s old. Angles only: where a loaded machine delays all processes, they hold later."""
    vehicle = flight
    vehicle.tell(set={'loss_time': 10.0})
    vehicle.tell(target={'azimuth': 1.0, 'rate': RATE, 'age': 0.4})
    state = vehicle.wait(lambda state: math.degrees(state['rms'] or math.inf) < 2.0, 40.0, 'settled')
    print(f"{math.degrees(state['rms']):.2f} deg rms over 4 s")
    vehicle.tell(target=None)
    start = vehicle.state['time']
    state = vehicle.wait(lambda state: state['time'] > start + 2.0 and state['yaw_rate'] == 0.0, why='still')
    turned = abs(math.degrees(state['since_bearing']))
    print(f"turned by {turned:.1f} deg from 0.3 s after the newest bearing")
    assert state['nav_state'] == 14 and state['foreign'] == 0 and turned < 10.0
