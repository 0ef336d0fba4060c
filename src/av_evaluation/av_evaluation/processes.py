"""Processes of a program started here: which belong to it, and their memory, threads and descriptors (Linux)."""

from __future__ import annotations

import os
import signal
import subprocess
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

MARK = 'AV_MARKED_RUN'   # no other program's: the launch has a variable of its own, AV_RIG_RUN
MIB = 1 / 1024   # per KiB
NODE_NAME = '__node:='
INTERPRETERS = ('python', 'bash', 'sh')
ENDS_IN_S = 60.0   # a launch: the monitor draws an hour's plot


@dataclass(frozen=True)
class ProcessSample:
    """What a process holds at one moment.

    Attributes:
        resident (MiB): its memory, pages shared with other processes included.
        proportional (MiB): its memory, a page shared by n processes counted as 1/n; 0 where the kernel does not say.
        private (MiB): memory of no other process.
        threads: number of its threads.
        descriptors: number of its open files, sockets and pipes.
    """

    resident: float
    proportional: float
    private: float
    threads: int
    descriptors: int


def sample(process_id: int) -> ProcessSample | None:
    """Measure a process, which takes about a millisecond; None where it has ended or belongs to another user."""
    folder = Path('/proc') / str(process_id)
    try:
        status = _numbers(folder / 'status')
        shares = _numbers(folder / 'smaps_rollup')
        descriptors = sum(1 for _ in (folder / 'fd').iterdir())
    except OSError:
        return None
    if 'VmRSS' not in status or 'Rss' not in shares:
        return None   # a zombie
    private = shares.get('Private_Clean', 0) + shares.get('Private_Dirty', 0)
    return ProcessSample(MIB * shares['Rss'], MIB * shares.get('Pss', 0), MIB * private, status['Threads'], descriptors)


def age_of(process_id: int) -> float:
    """Time (s) since a process was started; 0 where it has ended (proc(5): field 22 of stat)."""
    try:
        started = int((Path('/proc') / str(process_id) / 'stat').read_text().rpartition(')')[2].split()[19])
        now = float(Path('/proc/uptime').read_text().split()[0])
    except OSError:
        return 0.0
    return now - started / os.sysconf('SC_CLK_TCK')


def name_of(process_id: int) -> str:
    """Name of the ROS node of a process, or of its program, or of its parent's; empty where it has ended."""
    try:
        words = (Path('/proc') / str(process_id) / 'cmdline').read_bytes().decode(errors='replace').split('\0')
        parent = _numbers(Path('/proc') / str(process_id) / 'status').get('PPid', 0)
    except OSError:
        return ''
    named = [word[len(NODE_NAME):] for word in words if word.startswith(NODE_NAME)]
    programs = [Path(word).name for word in words if word and word[0] != '-' and ' ' not in word]
    program = next((name for name in programs if not name.startswith(INTERPRETERS)), '')
    return (named or [program])[0] or (f'child of {name_of(parent)}' if parent > 1 else words[0])


class MarkedProcesses:
    """A program and all processes that it starts, found by a variable in their environment even when it has ended.

    Parameters:
        command: words of the program.
        environment: variables to set or replace.
        output: file that takes what is printed, or subprocess.PIPE; None for this process' own output.

    Attributes:
        process: the program itself, leader of a process group of its own.
        environment: of the program; a process that is started with it counts as one of these, too.

    Raises OSError where the program cannot be started.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] | None = None,
                 output: IO[bytes] | int | None = None) -> None:
        self._mark = f'{MARK}={uuid.uuid4().hex}'.encode()
        self._name = Path(command[0]).name
        name, _, value = self._mark.decode().partition('=')
        self.environment = {**os.environ, **(environment or {}), name: value}
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT if output else None,
            env=self.environment, start_new_session=True)

    def alive(self) -> dict[int, str]:
        """Names of the processes that run, by process id, the program itself included."""
        found = {}
        for folder in Path('/proc').glob('[0-9]*'):
            try:
                ours = self._mark in (folder / 'environ').read_bytes().split(b'\0')
                state = (folder / 'stat').read_text().rpartition(')')[2].split()[0] if ours else 'Z'
            except OSError:
                continue   # ended meanwhile, or of another user
            if state != 'Z':
                number = int(folder.name)
                found[number] = self._name if number == self.process.pid else name_of(number)
        return found

    def run_times(self) -> dict[int, tuple[float, float]]:
        """For each thread, by its id, how long (s) it has run and has waited for a processor (schedstat of Linux)."""
        found = {}
        for process_id in self.alive():
            for file in (Path('/proc') / str(process_id) / 'task').glob('*/schedstat'):
                with suppress(OSError):   # ended meanwhile
                    ran, waited = map(int, file.read_text().split()[:2])
                    found[int(file.parent.name)] = 1e-9 * ran, 1e-9 * waited
        return found

    def signal(self, number: int) -> None:
        """Send a signal to every process that runs."""
        for process_id in self.alive():
            _send(process_id, number)


def slowdown(before: Mapping[int, tuple[float, float]], after: Mapping[int, tuple[float, float]]) -> float:
    """How much longer what threads computed has taken than on a machine of their own, by two of `run_times`."""
    ran, waited = (sum(times[k] - before.get(thread, (0.0, 0.0))[k] for thread, times in after.items()) for k in (0, 1))
    return 1.0 + waited / ran if ran > 0.0 else 1.0


@contextmanager
def launched_rig(arguments: Sequence[str], output: IO[bytes] | int = subprocess.DEVNULL) -> Iterator[MarkedProcesses]:
    """`ros2 launch av_fusion rig.launch.py`, which is interrupted in the end, and killed where it does not end by that.

    Parameters:
        arguments: of the launch file.
        output: file that takes what is printed.
    """
    rig = MarkedProcesses(['ros2', 'launch', 'av_fusion', 'rig.launch.py', *arguments], output=output)
    try:
        yield rig
    finally:
        rig.process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            rig.process.wait(ENDS_IN_S)
        rig.signal(signal.SIGKILL)


def _send(process_id: int, number: int) -> None:
    try:
        os.kill(process_id, number)
    except ProcessLookupError:
        return   # ended meanwhile


def _numbers(file: Path) -> dict[str, int]:
    """Numbers of a file of lines `name: number unit`."""
    rows = (line.split() for line in file.read_text().splitlines() if ':' in line)
    return {row[0].rstrip(':'): int(row[1]) for row in rows if len(row) > 1 and row[1].isdigit()}
