"""Which end of a process is the end of the rig, by the rules of av_bringup.supervision, without processes."""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import sys
import time

import pytest
from launch import LaunchContext, LaunchDescription, LaunchService
from launch.actions import EmitEvent, ExecuteProcess, LogInfo, TimerAction
from launch.events.process import ProcessExited, ShutdownProcess

from av_bringup import supervision
from av_bringup.supervision import MOST_RESTARTS, RESPAWN, SILENT_CHECKS, Supervision
from av_common.launched import HUNG, RESTARTS, RUN_FOLDER, started_file

KILLED, FAILED, CLEAN = -9, 1, 0
BUSY_CHECKS = 40


class Process:
    """In place of an ExecuteProcess."""

    def __init__(self, folder):
        self.process_details = {'env': {RUN_FOLDER: str(folder)}}


class Rig:
    """Supervised processes in name only: fusion is essential, recorder optional, and a monitor."""

    def __init__(self, folder, **options):
        self.folder, self._ids = folder, itertools.count(100)
        self.processes = {name: Process(folder) for name in ('fusion', 'recorder', 'monitor', 'foreign')}
        monitor = self.processes['monitor'] if options.pop('with_monitor', True) else None
        self.supervision = Supervision([self.processes['fusion']], [self.processes['recorder']], monitor, **options)

    def end(self, name, code, started=True):
        """What the launch does at the end of a process."""
        process, number = self.processes[name], next(self._ids)
        if started:
            started_file(self.folder, number).touch()
        event = ProcessExited(returncode=code, action=process, name=name, cmd=[], cwd=None, pid=number,
                              env=process.process_details['env'])
        return self.supervision._on_exit(event, LaunchContext())

    def restarts(self, name):
        """The count that the next process of a name is told."""
        return int(self.processes[name].process_details['env'].get(RESTARTS, 0))


@pytest.mark.parametrize('code', [KILLED, FAILED, CLEAN])
def test_an_essential_process_is_restarted_without_end(code, tmp_path):
    rig = Rig(tmp_path)
    for count in range(1, 20):
        (line,) = rig.end('fusion', code)
        assert isinstance(line, LogInfo) and rig.restarts('fusion') == count


@pytest.mark.parametrize('code', [KILLED, FAILED, CLEAN])
def test_more_than_three_restarts_fail_a_run_of_set_duration(code, tmp_path):
    rig = Rig(tmp_path, duration=100.0)
    for _ in range(MOST_RESTARTS):
        rig.end('fusion', code)
    with pytest.raises(RuntimeError, match='fusion .*after 3 restarts'):
        rig.end('fusion', code)


@pytest.mark.parametrize('name', ['fusion', 'recorder', 'monitor'])
def test_a_process_that_fails_at_its_first_start_ends_the_launch(name, tmp_path):
    with pytest.raises(RuntimeError, match=f'{name} ended with exit code 1'):
        Rig(tmp_path).end(name, FAILED, started=False)


def test_a_process_killed_before_it_has_started_is_restarted(tmp_path):
    rig = Rig(tmp_path)
    rig.end('fusion', KILLED, started=False)
    assert rig.restarts('fusion') == 1


def test_a_process_that_does_not_start_any_more_ends_the_launch(tmp_path):
    rig = Rig(tmp_path)
    rig.end('fusion', KILLED)
    for _ in range(MOST_RESTARTS):
        rig.end('fusion', FAILED, started=False)
    with pytest.raises(RuntimeError):
        rig.end('fusion', FAILED, started=False)


def test_the_recorder_may_die_as_often_as_it_likes(tmp_path):
    rig = Rig(tmp_path, duration=100.0)
    for count in range(1, 9):
        rig.end('recorder', KILLED)
        assert rig.restarts('recorder') == count


def test_a_recorder_that_does_not_start_any_more_is_given_up(tmp_path):
    rig = Rig(tmp_path, duration=100.0)
    rig.end('recorder', KILLED)
    for _ in range(MOST_RESTARTS):
        rig.end('recorder', FAILED, started=False)
    line, stop = rig.end('recorder', FAILED, started=False)
    assert isinstance(line, LogInfo) and isinstance(stop, EmitEvent) and isinstance(stop.event, ShutdownProcess)


@pytest.mark.parametrize('code', [KILLED, FAILED, CLEAN])
def test_without_the_monitor_the_run_goes_on_to_its_end(code, tmp_path):
    (line,) = Rig(tmp_path).end('monitor', code)
    assert isinstance(line, LogInfo)
    line, timer = Rig(tmp_path, duration=100.0).end('monitor', code)
    assert isinstance(line, LogInfo) and isinstance(timer, TimerAction)


def test_the_monitor_ends_a_run_that_has_lasted_its_duration(tmp_path):
    (end,) = Rig(tmp_path, duration=1e-9).end('monitor', CLEAN)
    assert isinstance(end, EmitEvent)


def test_results_that_nobody_writes_fail_the_run(tmp_path):
    with pytest.raises(RuntimeError, match='results'):
        Rig(tmp_path, duration=100.0, results=True).end('monitor', KILLED)


def test_processes_of_others_and_of_a_launch_that_ends_are_ignored(tmp_path):
    rig = Rig(tmp_path)
    assert rig.end('foreign', FAILED, started=False) is None


def test_without_a_monitor_a_timer_ends_the_run(tmp_path):
    assert len(Rig(tmp_path, with_monitor=False, duration=5.0).supervision.entities()) == 3
    assert len(Rig(tmp_path, with_monitor=False).supervision.entities()) == 2


@pytest.mark.parametrize('name', ['fusion', 'recorder', 'monitor'])
@pytest.mark.parametrize(('heartbeat', 'most'), [('{}', SILENT_CHECKS), ('busy {}', BUSY_CHECKS), ('', 10**9)])
def test_a_process_whose_heartbeat_stands_still_is_killed_and_counted(name, heartbeat, most, tmp_path, monkeypatch):
    """One that beats is not, nor one that never did, nor one that is busy for minutes; checks count, not their times."""
    rig, killed = Rig(tmp_path), []
    monkeypatch.setattr(supervision, 'BUSY_CHECKS', BUSY_CHECKS)
    monkeypatch.setattr(os, 'kill', lambda *what: killed.append(what))
    for number, process in enumerate(rig.processes, 500):
        rig.processes[process].process_details['pid'] = number
    victim = rig.processes[name].process_details['pid']

    def check(beats):
        for each, process in rig.processes.items():
            number = process.process_details['pid']
            if beats or each != name:
                started_file(tmp_path, number).write_text(heartbeat and heartbeat.format(next(rig._ids)))
        rig.supervision.check()

    for _ in range(2 * SILENT_CHECKS):
        check(beats=True)
    for _ in range(min(most, BUSY_CHECKS) - 1):
        check(beats=False)
    assert not killed
    for _ in range(3):
        check(beats=False)
    assert killed == ([(victim, signal.SIGKILL)] if most <= BUSY_CHECKS else [])
    if killed and name != 'monitor':
        rig._ids = itertools.count(victim)
        (line,) = rig.end(name, KILLED)
        assert 'hung and was killed' in line.msg[0].text and rig.restarts(name) == 1
        assert rig.processes[name].process_details['env'][HUNG] == '1'
        rig.end(name, KILLED)
        assert rig.restarts(name) == 2 and rig.processes[name].process_details['env'][HUNG] == '1'


@pytest.mark.parametrize(('state', 'ticks', 'most'), [
    ('S', 0, SILENT_CHECKS), ('T', 0, SILENT_CHECKS), ('R', 50, SILENT_CHECKS + 1), ('R', 5, 10 * SILENT_CHECKS + 1),
    ('R', 0, 10**9)])
def test_a_process_that_waits_for_a_processor_does_not_hang(state, ticks, most, tmp_path, monkeypatch):
    """One that sleeps, is stopped or spins does; one that is given a tenth of a processor has ten times as long."""
    monkeypatch.setattr(supervision, 'PROCESSES', tmp_path)
    monkeypatch.setattr(os, 'sysconf', lambda _: 100)
    pulse, folder = supervision.Pulse(), tmp_path / '7' / 'task'
    for thread in ('7', '8'):
        (folder / thread).mkdir(parents=True)
    (folder / '8' / 'stat').write_text('8 (a) b) S ' + '0 ' * 40)
    for check in range(400):
        (folder / '7' / 'stat').write_text(f'7 (node) {state} {"0 " * 10}{ticks * check} 0 {"0 " * 30}')
        if pulse.hangs(7, 'a heartbeat'):
            break
    assert check == min(most, 399)


PROGRAM = """
import os, time
from av_common.launched import HUNG, beat, restarts
print('process', os.getpid(), restarts(), restarts(HUNG), flush=True)
while True:
    beat()
    time.sleep(0.02)
"""


def test_a_stopped_process_of_a_launch_is_replaced(tmp_path, monkeypatch):
    """SIGSTOP, as a debugger or a full terminal does; the next process knows why it is there."""
    monkeypatch.setattr(supervision, 'BEAT_PERIOD_S', 0.05)
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    process = ExecuteProcess(cmd=[sys.executable, '-c', PROGRAM], output='log', **RESPAWN)
    entities = Supervision([process]).entities()

    async def run():
        service = LaunchService(noninteractive=True)
        service.include_launch_description(LaunchDescription([*entities, process]))
        running, first, end = asyncio.ensure_future(service.run_async()), None, time.monotonic() + 20.0
        while time.monotonic() < end:
            await asyncio.sleep(0.02)
            number = (process.process_details or {}).get('pid')
            if first is None and number and started_file(tmp_path, number).exists():
                first = number
                os.kill(first, signal.SIGSTOP)
            if first is not None and number != first and started_file(tmp_path, number).exists():
                break
        await service.shutdown()
        await running
        process._subprocess_transport.close()    # while its loop is there
        await asyncio.sleep(0.05)
        return first, number

    first, second = asyncio.run(run())
    assert first and second != first
    assert (process.process_details['env'][RESTARTS], process.process_details['env'][HUNG]) == ('1', '1')
