"""The guard ends what a killed launch leaves behind, and only that."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from machine_load import slowness

from av_bringup import guard

pytestmark = pytest.mark.system

# A launch in miniature: the guard and children that sleep, ignore SIGTERM, or are stopped.
LAUNCH = """
import os, signal, subprocess, sys, time
guard, mark, *kinds = sys.argv[1:]
subprocess.Popen([sys.executable, '-I', '-S', guard, mark, str(os.getpid())])
environment = {**os.environ, **dict([mark.split('=')])}
ignoring = 'import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print("up", flush=True); time.sleep(600)'
sleeping = 'import time; print("up", flush=True); time.sleep(600)'
for kind in kinds:
    child = subprocess.Popen([sys.executable, '-c', ignoring if kind == 'ignoring' else sleeping], env=environment,
                             stdout=subprocess.PIPE)
    child.stdout.readline()
    if kind == 'stopped':
        os.kill(child.pid, signal.SIGSTOP)
print('ready', flush=True)
time.sleep(600)
"""


def guards(mark: str) -> list[int]:
    """Ids of the guard processes of a launch."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            if mark.encode() in (folder / 'cmdline').read_bytes() and b'guard.py\0AV' in (folder / 'cmdline').read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue
    return found


@pytest.fixture
def launch(tmp_path):
    """A started launch and the mark of its processes."""
    folder = tmp_path / 'run'
    folder.mkdir()
    mark = f'AV_GUARD_TEST={folder}'
    process = subprocess.Popen([sys.executable, '-c', LAUNCH, guard.__file__, mark, 'sleeping', 'ignoring', 'stopped'],
                               stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == 'ready\n'
    yield process, mark
    for left in [process.pid, *guard.find_processes(mark)]:
        guard.send(left, signal.SIGKILL)
    process.wait()


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGHUP])
def test_nothing_outlives_a_killed_launch(number, launch):
    """Neither a process that ignores SIGTERM nor a stopped one, nor the guard, nor the folder of the run."""
    process, mark = launch
    assert len(guard.find_processes(mark)) == 3
    process.send_signal(number)
    process.wait()
    deadline = time.monotonic() + 4.0 * slowness()    # 2 s on a machine without other load
    while (guard.find_processes(mark) or guards(mark)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not guard.find_processes(mark)
    assert not guards(mark)
    assert not Path(mark.partition('=')[2]).exists()


def test_processes_of_others_are_left_alone(launch):
    """A process whose mark begins alike is not the launch's."""
    process, mark = launch
    other = subprocess.Popen(['sleep', '600'], env=dict([f'{mark}2'.split('=')]))
    process.kill()
    process.wait()
    time.sleep(2.0)
    assert other.poll() is None
    other.kill()
    other.wait()


# A launch whose process says that it is interrupted.
DESCRIBED = '''
import sys
from launch import LaunchService
from launch.actions import ExecuteProcess
from av_bringup.launching import describe
program = """import os, time
print("run", os.environ.get("AV_RIG_RUN"), flush=True)
try:
    time.sleep(60)
except KeyboardInterrupt:
    print("interrupted", flush=True)"""
process = ExecuteProcess(cmd=[sys.executable, '-c', program], output='screen')
service = LaunchService(argv=[])
service.include_launch_description(describe({'params': ('', '', None)}, lambda _: [process]))
sys.exit(service.run())
'''


def test_a_process_belongs_to_the_run():
    """It has the folder of the run, for heartbeats, switches and the guard, and ends with the launch."""
    launch = subprocess.Popen([sys.executable, '-c', DESCRIBED], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    said = next(line for line in launch.stdout if '] run ' in line)
    assert '/av_rig_' in said
    launch.send_signal(signal.SIGINT)
    assert 'interrupted' in launch.communicate(timeout=20)[0]
