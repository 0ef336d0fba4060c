"""Processes of the rig are started again when they end, and none outlives the launch."""

from __future__ import annotations

import os
import signal
import time

import pytest
from machine_load import skip_figures_where_overloaded, slowness
from rig_listener import TOPICS, RigListener
from rig_process import RigProcess
from udp_ports import free_offset

pytestmark = pytest.mark.system

NODES = tuple(name for name in TOPICS if name != 'simulator')


@pytest.fixture
def start():
    """Start a rig whose drone is in the camera's view, with a listener, and wait until it is tracked."""
    listeners = []

    def start(*arguments):
        rig = RigProcess('scenario:=circle', 'oracle:=true', *arguments, f'port_offset:={free_offset()}')
        listeners.append(RigListener(rig.domain))
        assert listeners[-1].wait_for(lambda: listeners[-1].tracked, timeout=180.0), rig.output
        return rig, listeners[-1]
    yield start
    for listener in listeners:
        listener.close()


def kill(rig, listener, name, number=signal.SIGKILL):
    """End the process of a name; returns the seconds until the messages of the next one, and until the drone is tracked again.

    Tracked are bearings with a target for a second without a gap of 0.5 s; the time is that of the first of them.
    """
    (process,) = rig.processes(f'/{name}')
    os.kill(process, number)
    begin = time.monotonic()
    assert listener.wait_for(lambda: rig.processes(f'/{name}') not in ([], [process])), rig.output
    ended = time.monotonic()    # what came before is of the process that has ended, as none starts within its respawn delay
    assert listener.wait_for(lambda: listener.arrivals[name] > ended), rig.output
    back = listener.arrivals[name] - begin
    assert listener.wait_for(lambda: listener.tracked - max(listener.tracked_since, begin) > 1.0), rig.output
    return back, max(listener.tracked_since - begin, 0.0)


def nothing_outlives(rig, listener, number):
    """However the launch ends: no process after 2 s, and the last command moves nothing."""
    rig.signal(number)
    rig.finish(60.0)
    ended = time.monotonic()
    left = rig.leftovers()
    print(f'\n{number.name}: the last process ended {time.monotonic() - ended:.1f} s after the launch')
    assert not left
    listener.wait_for(lambda: False, timeout=0.5)
    assert still(listener.commands[-1])


def still(command):
    """Whether a command moves nothing."""
    gimbal = command.move_gimbal and (command.pan_rate or command.tilt_rate)
    return not gimbal and not (command.move_body and command.yaw_rate)


def test_essential_processes_are_started_again(start):
    """Killed one after the other, each returns and is counted; the drone is tracked after each; the rig ends well."""
    rig, listener = start()
    times = {name: kill(rig, listener, name) for name in TOPICS}
    print('\n' + '\n'.join(f'{name:<16} back after {back:.1f} s, tracking after {tracking:.1f} s'
                           for name, (back, tracking) in times.items()))
    for name in NODES:
        assert listener.wait_for(lambda name=name: listener.values[name].get('restarts') == '1'), (name, listener.values)
    os.kill(rig.processes('monitor_node')[0], signal.SIGKILL)
    assert listener.wait_for(lambda: 'goes on without it' in rig.output)
    begin = time.monotonic()
    assert listener.wait_for(lambda: listener.tracked > begin + 1.0)
    rig.interrupt()
    assert rig.finish(60.0) == 0, rig.output
    assert not rig.leftovers()
    skip_figures_where_overloaded()
    for name, (back, tracking) in times.items():
        assert back < 2.0 * slowness() and tracking < 3.0 * slowness(), (name, times)


def test_a_node_that_is_shut_down_by_request_is_started_again(start):
    """Its process ends, since a finalized node does nothing, and the launch sees that."""
    rig, listener = start('monitor:=false')
    (process,) = rig.processes('/doa_node')
    assert listener.shut_down('doa_node')
    assert listener.wait_for(lambda: rig.processes('/doa_node') not in ([], [process])), rig.output
    assert listener.wait_for(lambda: listener.values.get('doa_node', {}).get('restarts') == '1'), rig.output
    nothing_outlives(rig, listener, signal.SIGHUP)


def test_more_than_three_restarts_fail_a_run_of_set_duration(start):
    """Three are none, the fourth end of one process ends the run with a code other than 0 and its name."""
    rig, listener = start('duration:=120', 'monitor:=false')
    for _ in range(3):
        kill(rig, listener, 'doa_node')
    assert rig.running_now
    os.kill(rig.processes('/doa_node')[0], signal.SIGTERM)
    assert rig.finish(60.0) != 0
    assert 'doa_node' in rig.output and 'after 3 restarts' in rig.output, rig.output
    assert not rig.leftovers()


def test_a_node_that_refuses_its_parameters_is_not_started_again(tmp_path):
    """The launch ends with the reason, as for every mistake in its arguments."""
    parameters = tmp_path / 'wrong.yaml'
    parameters.write_text('/**/fusion_node:\n  ros__parameters: {rate: 1.0e+9}\n')
    rig = RigProcess(f'params:={parameters}', f'port_offset:={free_offset()}')
    assert rig.finish(60.0) != 0
    assert 'rate' in rig.output and 'fusion_node' in rig.output
    assert 'restart 1' not in rig.output, rig.output
    assert not rig.leftovers()


def test_a_monitor_that_dies_does_not_change_the_duration():
    """The run ends in its time, and well, as nobody asked for results."""
    rig = RigProcess('oracle:=true', 'duration:=15', f'port_offset:={free_offset()}')
    rig.wait_for('monitor_node')
    begin = time.monotonic()
    rig.wait_for('no target|deg')
    os.kill(rig.processes('monitor_node')[0], signal.SIGTERM)
    assert rig.finish(60.0) == 0, rig.output
    assert time.monotonic() - begin > 12.0
    assert not rig.leftovers()


def test_what_was_disabled_stays_disabled(start):
    """Whether commands move the rig outlives the process of the node that decides it."""
    rig, listener = start()
    assert listener.wait_for(lambda: listener.values.get('pointing_node', {}).get('enabled') == 'True')
    assert 'nothing' in listener.enable(False)
    kill(rig, listener, 'pointing_node')
    listener.commands.clear()
    assert listener.wait_for(lambda: len(listener.commands) > 40)
    assert all(map(still, listener.commands))
    assert listener.wait_for(lambda: listener.values['pointing_node'].get('restarts') == '1')
    assert listener.values['pointing_node']['enabled'] == 'False'
    nothing_outlives(rig, listener, signal.SIGINT)


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_nothing_outlives_the_launch(number, start):
    nothing_outlives(*start(), number)
