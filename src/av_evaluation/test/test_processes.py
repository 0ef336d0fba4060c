"""Processes are found by the mark that they inherit, and measured from outside."""

import os
import signal
import sys
import time
from types import SimpleNamespace

import psutil
import pytest

from av_evaluation.processes import MarkedProcesses, launched_rig, name_of, sample

pytestmark = pytest.mark.system

PROGRAM = '''
import subprocess, sys, threading, time
kept = bytearray(b'x' * 50_000_000)
files = [open('/dev/null') for _ in range(20)]
for _ in range(3):
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
node = [sys.executable, '-c', 'import time; time.sleep(60)', '--ros-args', '-r', '__node:=some_node']
subprocess.Popen(node, start_new_session=True)
print('ready', flush=True)
time.sleep(60)
'''


@pytest.fixture
def started(tmp_path):
    with (tmp_path / 'log').open('wb') as log:
        program = MarkedProcesses([sys.executable, '-c', PROGRAM], {'OTHER': '1'}, log)
    deadline = time.monotonic() + 120.0
    while (tmp_path / 'log').read_text() != 'ready\n' or 'some_node' not in program.alive().values():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    yield program
    program.signal(signal.SIGKILL)
    program.process.wait(60.0)


def test_memory_threads_and_descriptors_are_measured(started):
    own = sample(started.process.pid)
    assert 50.0 < own.resident < 120.0
    assert own.threads == 4
    assert 23 <= own.descriptors < 30


def test_children_are_found_and_named_even_when_their_parent_is_gone(started):
    assert sorted(started.alive().values())[-1] == 'some_node'
    assert len(started.alive()) == 2
    started.process.kill()
    started.process.wait(60.0)
    assert list(started.alive().values()) == ['some_node']
    started.signal(signal.SIGKILL)
    deadline = time.monotonic() + 60.0
    while started.alive():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_what_has_ended_has_no_name_and_no_memory():
    ended = os.spawnl(os.P_NOWAIT, sys.executable, sys.executable, '-c', '')
    os.waitid(os.P_PID, ended, os.WEXITED | os.WNOWAIT)
    assert sample(ended) is None   # a zombie
    os.waitpid(ended, 0)
    assert sample(ended) is None
    assert name_of(ended) == ''


def test_an_orphan_that_is_ending_has_no_name(monkeypatch):
    """Linux has taken its memory, and with that the words of its command line."""
    monkeypatch.setattr(psutil, 'Process', lambda _: SimpleNamespace(cmdline=list, ppid=lambda: 1))
    assert name_of(5) == ''


def test_a_launch_that_does_not_end_is_killed_also_where_ctrl_c_is_typed_again(tmp_path, monkeypatch):
    (tmp_path / 'ros2').write_text('#!/bin/bash\ntrap "" INT\nsleep 100 &\ntouch "$0.ready"\nwait\n')
    (tmp_path / 'ros2').chmod(0o700)
    monkeypatch.setenv('PATH', f'{tmp_path}:{os.environ["PATH"]}')

    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), launched_rig([]) as rig:
        monkeypatch.setattr(rig.process, 'wait', interrupted)
        deadline = time.monotonic() + 60.0
        while not (tmp_path / 'ros2.ready').exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
    while rig.alive():
        assert time.monotonic() < deadline
        time.sleep(0.05)
