"""Which end of a process is the end of the rig, by the rules of av_bringup.supervision, without processes."""

from __future__ import annotations

import itertools

import pytest
from launch import LaunchContext
from launch.actions import EmitEvent, LogInfo, TimerAction
from launch.events.process import ProcessExited, ShutdownProcess

from av_bringup.supervision import MOST_RESTARTS, Supervision
from av_common.launched import RESTARTS, RUN_FOLDER, started_file

KILLED, FAILED, CLEAN = -9, 1, 0


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
    assert len(Rig(tmp_path, with_monitor=False, duration=5.0).supervision.entities()) == 2
    assert len(Rig(tmp_path, with_monitor=False).supervision.entities()) == 1
