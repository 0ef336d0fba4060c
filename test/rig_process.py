"""Runs the launch file as a user would, and detects processes that remain afterwards."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import threading
import time
import uuid
from pathlib import Path
from typing import ClassVar

from machine_load import slowness

MARK = 'AV_RIG_TEST_RUN'


class RigProcess:
    """`ros2 launch av_fusion rig.launch.py ARGUMENTS` in a process group, ROS domain and UDP port range of its own."""

    running: ClassVar[list[RigProcess]] = []  # killed after each test by the fixture in conftest.py

    def __init__(self, *arguments: str, launch_file: str = 'rig.launch.py') -> None:
        self._run = uuid.uuid4().hex
        self.domain = random.SystemRandom().randrange(1, 100)
        self.environment = {**os.environ, MARK: self._run, 'ROS_DOMAIN_ID': str(self.domain), 'PYTHONUNBUFFERED': '1'}
        self._process = subprocess.Popen(
            ['ros2', 'launch', 'av_fusion', launch_file, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL, text=True, env=self.environment, start_new_session=True)
        self._lines: list[str] = []
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
        return ''.join(self._lines)

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
        found = []
        for folder in Path('/proc').glob('[0-9]*'):
            try:
                if (f'{MARK}={self._run}'.encode() in (folder / 'environ').read_bytes()
                        and name.encode() in (folder / 'cmdline').read_bytes()
                        and (folder / 'stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'):
                    found.append(int(folder.name))
            except OSError:
                continue  # ended meanwhile, or not ours
        return found

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
        for process in self.processes():
            os.kill(process, signal.SIGKILL)
