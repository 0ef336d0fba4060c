"""The rig and its simulator on two hosts, with a third that would like to steer."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time

import pytest
from network_hosts import OTHER, RIG, STRANGER, two_hosts
from rig_process import RigProcess
from test_allowed_senders import sender_at
from udp_ports import free_offset

from av_sim_bridge.wire.oracle import OracleBox, encode_oracle
from av_sim_bridge.wire.ports import Ports
from av_sim_bridge.wire.rig_control import RigControl, encode_rig_control

pytestmark = pytest.mark.system


def test_a_simulator_on_another_host_is_obeyed_and_a_stranger_is_not():
    """The rig follows the simulator that it is told of, and turns it; boxes and commands of the stranger change nothing."""
    offset = free_offset()
    ports = Ports().shifted(offset)
    with two_hosts() as (near, far):
        rig = near.run(lambda: RigProcess(
            'source:=udp', 'oracle:=true', 'enable_pointing:=true', 'duration:=25', f'port_offset:={offset}',
            f'bind_address:={RIG}', f'allowed_senders:={OTHER}', f'control_host:={OTHER}'))
        simulator = far.run(lambda: subprocess.Popen(
            [sys.executable, '-m', 'av_simulator.cli.simulator', 'behind_in_fog', '--host', RIG, '--bind-address', OTHER,
             '--port-offset', str(offset), '--audio-header', '--renderer', 'flat', '--duration', 'inf'],
            stderr=subprocess.PIPE, text=True, env=rig.marked.environment))
        try:
            rig.wait_for(r'deg \+-')
            stranger = far.run(sender_at, STRANGER)
            local = far.run(sender_at, OTHER)    # on the simulator's host, but not the bridge
            for _ in range(50):
                stranger.sendto(encode_oracle([OracleBox(2, 1.0, 600.0, 200.0, 630.0, 230.0)]), (RIG, ports.image))
                for source in (stranger, local):
                    source.sendto(encode_rig_control(RigControl(1, 1, yaw_rate=1.0)), (OTHER, ports.control))
                time.sleep(0.02)
            assert rig.finish() == 0, rig.output
        finally:
            simulator.send_signal(signal.SIGINT)
            try:
                _, log = simulator.communicate(timeout=30.0)
            finally:
                simulator.kill()
    assert re.search(rf'command from {re.escape(STRANGER)}:\d+ refused, obeyed is {re.escape(RIG)}:{ports.rig_truth}', log), log
    counts = {name: int(count) for count, name in re.findall(r'(\d+) ([a-z ]+)', log.splitlines()[-1])}
    assert counts['commands'] > 20 and counts['refused commands'] == 100, log
    assert not rig.leftovers()
