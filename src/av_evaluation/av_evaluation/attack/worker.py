"""A process beside the program that takes requests as lines of JSON and answers each with one."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

CLOSED = ''


class WorkerError(RuntimeError):
    """A process of the attack failed, or did not answer in time."""


class Worker:
    """Starts a module of this package as a process, and calls its functions.

    Parameters:
        module: name of the module, which calls `serve`.
        environment: variables to set or replace.
        log: file to which is appended what the process says; the middleware says much.
        prefix: words of a command that runs the process, such as `nsenter`.
    """

    def __init__(self, module: str, log: Path, environment: Mapping[str, str] | None = None,
                 prefix: Sequence[str] = ()) -> None:
        self._module = module
        with log.open('ab') as output:
            self._process = subprocess.Popen(
                [*prefix, sys.executable, '-m', f'av_evaluation.attack.{module}'], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=output, text=True, env={**os.environ, **(environment or {})})
        assert self._process.stdout is not None
        self._answers = _lines(self._process.stdout)

    def send(self, function: str, **arguments: Any) -> None:
        """Request a call without waiting for its result. Raises WorkerError where the process has ended."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps([function, arguments]) + '\n')
            self._process.stdin.flush()
        except OSError as error:
            raise WorkerError(f'{self._module} has ended') from error

    def receive(self, timeout: float) -> Any:
        """The result of the oldest call without one. Raises WorkerError after `timeout` (s), or where the call failed."""
        try:
            line = self._answers.get(timeout=timeout)
        except queue.Empty as error:
            raise WorkerError(f'{self._module} does not answer') from error
        if line == CLOSED:
            raise WorkerError(f'{self._module} has ended')
        answer = json.loads(line)
        if 'error' in answer:
            raise WorkerError(f'{self._module}: {answer["error"]}')
        return answer['result']

    def call(self, function: str, timeout: float = 30.0, **arguments: Any) -> Any:
        """Call a function and wait for its result. Raises WorkerError."""
        self.send(function, **arguments)
        return self.receive(timeout)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait(10.0)


def serve(functions: Mapping[str, Callable[..., Any]], idle: Callable[[float], None] | None = None) -> None:
    """Answer requests until standard input is closed: the body of a worker's `main`.

    Parameters:
        functions: what can be called, by name.
        idle: called again and again between requests with the time to spend (s); None waits.
    """
    requests = _lines(sys.stdin)
    while True:
        try:
            line = requests.get(block=idle is None)
        except queue.Empty:
            assert idle is not None
            idle(0.02)
            continue
        if line == CLOSED:
            return
        name, arguments = json.loads(line)
        try:
            answer = {'result': functions[name](**arguments)}
        except Exception as error:  # noqa: BLE001  the program decides
            answer = {'error': f'{name}: {type(error).__name__}: {error}'}
        with suppress(BrokenPipeError):
            print(json.dumps(answer), flush=True)


def _lines(stream: Iterable[str]) -> queue.Queue[str]:
    lines: queue.Queue[str] = queue.Queue()

    def read() -> None:
        for line in stream:
            lines.put(line)
        lines.put(CLOSED)
    threading.Thread(target=read, daemon=True).start()
    return lines
