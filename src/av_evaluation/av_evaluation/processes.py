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

import psutil

MARK = 'AV_MARKED_RUN'   # no other program's: the launch has a variable of its own, AV_RIG_RUN
MIB = 1 << 20   # bytes
NODE_NAME = '__node:='
INTERPRETERS = ('python', 'bash', 'sh')
ENDS_IN_S = 60.0   # a launch: the monitor draws an hour's plot


@dataclass(frozen=True)
class ProcessSample:
    """What a process holds at one moment.

    Attributes:
        resident (MiB): its memory, pages shared with other processes included.
        threads: number of its threads.
        descriptors: number of its open files, sockets and pipes.
    """

    resident: float
    threads: int
    descriptors: int


def sample(process_id: int) -> ProcessSample | None:
    """Measure a process, which takes about a millisecond; None where it has ended or belongs to another user."""
    with suppress(psutil.Error):
        process = psutil.Process(process_id)
        resident, status = process.memory_info().rss / MIB, process.status()
        return None if status == psutil.STATUS_ZOMBIE else ProcessSample(resident, process.num_threads(), process.num_fds())
    return None


def name_of(process_id: int) -> str:
    """Name of the ROS node of a process, or of its program, or of its parent's; empty where it has ended."""
    try:
        process = psutil.Process(process_id)
        words, parent = process.cmdline(), process.ppid()
    except psutil.Error:
        return ''
    named = [word[len(NODE_NAME):] for word in words if word.startswith(NODE_NAME)]
    programs = [Path(word).name for word in words if word and word[0] != '-' and ' ' not in word]
    program = next((name for name in programs if not name.startswith(INTERPRETERS)), '')
    return [*named, program][0] or (f'child of {name_of(parent)}' if parent > 1 else ''.join(words[:1]))


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
        self._mark, self._name = uuid.uuid4().hex, Path(command[0]).name
        self.environment = {**os.environ, **(environment or {}), MARK: self._mark}
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT if output else None,
            env=self.environment, start_new_session=True)

    def alive(self) -> dict[int, str]:
        """Names of the processes that run, by process id, the program itself included."""
        found = {}
        for process in psutil.process_iter():
            with suppress(psutil.Error):   # ended meanwhile, or of another user
                if process.environ().get(MARK) == self._mark and process.status() != psutil.STATUS_ZOMBIE:
                    found[process.pid] = self._name if process.pid == self.process.pid else name_of(process.pid)
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
            with suppress(psutil.NoSuchProcess):   # ended meanwhile
                psutil.Process(process_id).send_signal(number)


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
        try:
            rig.process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                rig.process.wait(ENDS_IN_S)
        finally:    # Ctrl-C twice, too
            rig.signal(signal.SIGKILL)
