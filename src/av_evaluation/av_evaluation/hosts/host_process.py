"""A process in a host that prints lines of JSON."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

END_S = 10.0  # in which it must end when its input does


class HostProcess:
    """Starts a process, reads what it prints, and ends it by the end of its input, or by SIGTERM.

    Parameters:
        command: its words.
        environment: its environment.
        log: file that takes its other output.

    Raises OSError where it cannot be started.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str], log: Path) -> None:
        self._log, self._lines = log, list[dict[str, Any]]()
        with log.open('w') as file:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=file, text=True,
                                             env=dict(environment))
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith('{'):
                self._lines.append(json.loads(line))

    def check(self) -> None:
        """Raise RuntimeError, with the last line of its log, if it has ended."""
        if self._process.poll() is not None:
            last = [line for line in self._log.read_text().splitlines() if line.strip()][-1:]
            raise RuntimeError(f'{self._log.stem} ended with {self._process.returncode}: {" ".join(last)}')

    def write(self, line: str) -> None:
        """Write a line to its input."""
        assert self._process.stdin is not None
        print(line, file=self._process.stdin, flush=True)

    def values(self, name: str) -> list[dict[str, Any]]:
        """All lines so far that have a value of this name."""
        return [line for line in list(self._lines) if name in line]

    def newest(self, name: str) -> Any:
        """The newest value of this name, None without one."""
        return next((line[name] for line in reversed(list(self._lines)) if name in line), None)

    def close(self) -> None:
        """End it."""
        with suppress(OSError):
            self._process.stdin.close()    # type: ignore[union-attr]
        self._process.terminate()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(END_S)
