"""The rig under attack: its processes, which of them died, and how their memory grows."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from av_evaluation.processes import MarkedProcesses, ProcessSample, sample

EVERY = 0.2         # s between looks at the process table
LAUNCH = 'ros2'
SHUTDOWN = 20.0     # s
SETTLED = 10.0      # s after which a process has all the memory that it needs
Memory = dict[int, tuple[str, ProcessSample]]


def is_part(name: str) -> bool:
    """Whether a process is one of the rig's own programs, rather than a child of one."""
    return name.endswith('_node') or name in (LAUNCH, 'simulator')


class Rig:
    """`ros2 launch av_fusion rig.launch.py` under observation.

    Attributes:
        deaths: names and times of processes that ended and were not killed here.

    Parameters:
        arguments: launch arguments.
        log: file for what the rig prints.
        environment: variables to set or replace.
    """

    def __init__(self, arguments: Sequence[str], log: Path, environment: dict[str, str]) -> None:
        self._arguments, self._log, self._environment = arguments, log, environment
        self.deaths: list[tuple[float, str]] = []
        self._killed: set[int] = set()
        self._lock, self._closing = threading.Lock(), threading.Event()
        self.start()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def start(self) -> None:
        """Start the launch."""
        with self._log.open('ab') as output:
            launched = MarkedProcesses(['ros2', 'launch', 'av_fusion', 'rig.launch.py', *self._arguments],
                                       self._environment, output)
        with self._lock:
            self._processes, self._alive, self._watched = launched, dict[int, str](), True
            self._since: dict[int, float] = {}    # times (s) at which processes were first seen

    @property
    def ended(self) -> bool:
        """Whether the launch has ended."""
        return self._processes.process.poll() is not None

    def alive(self) -> dict[str, int]:
        """Process ids by name."""
        with self._lock:
            return {name: process_id for process_id, name in self._alive.items()}

    def signal(self, name: str, number: int) -> int:
        """Send a signal to a process; returns its id. Raises KeyError where it does not run.

        Parameters:
            name: of the process.
            number: of the signal; with SIGKILL its end is not counted as a death.
        """
        process_id = self.alive()[name]
        if number == signal.SIGKILL:
            self._killed.add(process_id)
        os.kill(process_id, number)
        return process_id

    def measure(self) -> Memory:
        """Name and measurements of each process that runs for at least SETTLED s, by process id."""
        with self._lock:
            old = {process_id: name for process_id, name in self._alive.items()
                   if time.monotonic() - self._since[process_id] >= SETTLED}
        taken = {process_id: (name, sample(process_id)) for process_id, name in old.items()}
        return {process_id: (name, one) for process_id, (name, one) in taken.items() if one is not None}

    def restart(self) -> None:
        """End the launch with all its processes, and start it again."""
        self._end()
        self.start()

    def close(self) -> None:
        """End everything."""
        self._closing.set()
        self._watcher.join(10.0)
        self._end()

    def _end(self) -> None:
        with self._lock:
            self._alive, self._watched = {}, False
        with suppress(ProcessLookupError):
            os.killpg(self._processes.process.pid, signal.SIGINT)
        deadline = time.monotonic() + SHUTDOWN
        while self._processes.alive() and time.monotonic() < deadline:
            time.sleep(0.2)
        self._processes.signal(signal.SIGKILL)
        self._processes.process.wait(10.0)

    def _watch(self) -> None:
        while not self._closing.wait(EVERY):
            processes = self._processes
            alive = {process_id: name for process_id, name in processes.alive().items() if is_part(name)}
            with self._lock:
                if processes is not self._processes or not self._watched:
                    continue
                ended = [(process_id, name) for process_id, name in self._alive.items() if process_id not in alive]
                self.deaths += [(time.time(), name) for process_id, name in ended if process_id not in self._killed]
                self._alive = {process_id: name for process_id, name in alive.items() if process_id not in self._killed}
                self._since = {process_id: self._since.get(process_id, time.monotonic()) for process_id in self._alive}


def growth(before: Memory, after: Memory) -> dict[str, float]:
    """Growth of the memory (MiB) by name of the processes that are in both."""
    return {name: taken.resident - before[process_id][1].resident for process_id, (name, taken) in after.items()
            if process_id in before}


def free_domain() -> int:
    """A ROS domain that is probably nobody's: 1 to 100, above which the ports of DDS meet Linux's ephemeral ones."""
    return random.SystemRandom().randrange(1, 101)
