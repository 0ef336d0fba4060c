"""Runs the launch file as a user would, and detects processes that remain afterwards."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import ClassVar

from machine_load import slowness
from ros_domains import free_domain

from av_evaluation.processes import MarkedProcesses


class RigProcess:
    """`ros2 launch av_fusion rig.launch.py ARGUMENTS` in a process group, ROS domain and UDP port range of its own.

    Parameters:
        arguments: of the launch.
        launch_file: of `av_fusion`.
        domain: the ROS domain, for a second rig in that of the first; None for a free one.
    """

    running: ClassVar[list[RigProcess]] = []  # killed after each test by the fixture in conftest.py

    def __init__(self, *arguments: str, launch_file: str = 'rig.launch.py', domain: int | None = None) -> None:
        self.domain = free_domain() if domain is None else domain
        self.marked = MarkedProcesses(['ros2', 'launch', 'av_fusion', launch_file, *arguments],
                                       {'ROS_DOMAIN_ID': str(self.domain), 'PYTHONUNBUFFERED': '1'}, subprocess.PIPE)
        self._process = self.marked.process
        self._lines: list[bytes] = []
        self._reader = threading.Thread(target=lambda: self._lines.extend(self._process.stdout), daemon=True)
        self._reader.start()
        RigProcess.running.append(self)

    @property
    def running_now(self) -> bool:
        """Whether the launch has not ended yet."""
        return self._process.poll() is None

    @property
    def output(self) -> str:
        """What was printed so far."""
        return b''.join(self._lines).decode(errors='replace')

    def finish(self, timeout: float = 120.0) -> int:
        """Wait for the end; returns the exit code. Raises TimeoutExpired when it hangs."""
        code = self._process.wait(timeout)
        self._reader.join(10.0)
        return code

    def interrupt(self) -> None:
        """Ctrl-C: SIGINT to the whole foreground process group."""
        os.killpg(self._process.pid, signal.SIGINT)

    def signal(self, number: signal.Signals) -> None:
        """A signal to the launch alone, not to its processes."""
        self._process.send_signal(number)

    def wait_for(self, pattern: str, timeout: float = 90.0) -> None:
        """Wait until the output matches. Raises AssertionError with the output when it does not, or the rig ends."""
        deadline = time.monotonic() + timeout
        while not re.search(pattern, self.output):
            assert self._process.poll() is None and time.monotonic() < deadline, f'no {pattern!r} in:\n{self.output}'
            time.sleep(0.2)

    def processes(self, name: str = '') -> list[int]:
        """Process ids of this run that are alive, those whose command line holds `name`."""
        return [process for process in self.marked.alive() if not name or name.encode() in _words_of(process)]

    def leftovers(self) -> list[int]:
        """Process ids that outlive the run by more than two seconds, or as much longer as the machine is overloaded."""
        deadline = time.monotonic() + 2.0 * slowness()
        while self.processes() and time.monotonic() < deadline:
            time.sleep(0.1)
        return self.processes()

    def value(self, label: str) -> float:
        """The first number in the table's row `label`."""
        match = re.search(rf'{re.escape(label)}\s+(-?[\d.]+)', self.output)
        assert match, f'no row {label!r} in:\n{self.output}'
        return float(match.group(1))

    def kill(self) -> None:
        """Leave nothing behind, whatever the test found."""
        self.marked.signal(signal.SIGKILL)


def _words_of(process: int) -> bytes:
    try:
        return Path(f'/proc/{process}/cmdline').read_bytes()
    except OSError:
        return b''  # ended meanwhile
