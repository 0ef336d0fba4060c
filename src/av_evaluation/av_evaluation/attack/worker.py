"""Processes that attack: they take calls as lines of JSON, answer each with one, and send at a steady rate."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

STEP_S = 0.01    # between looks at what is due


class WorkerError(RuntimeError):
    """A process of the attack failed, or did not answer in time."""


class Worker:
    """Starts a module of this package as a process, and calls its functions.

    Parameters:
        module: name of the module, which calls `serve`.
        log: file to which is appended what the process says; the middleware says much.
        prefix: words of a command that runs the process, such as `nsenter`.
    """

    def __init__(self, module: str, log: Path, prefix: Sequence[str] = ()) -> None:
        self._module = module
        with log.open('ab') as output:
            self._process = subprocess.Popen(
                [*prefix, sys.executable, '-m', f'av_evaluation.attack.{module}'], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=output, text=True)

    def send(self, function: str, **arguments: Any) -> None:
        """Request a call without waiting for its result. Raises WorkerError where the process has ended."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps([function, arguments]) + '\n')
            self._process.stdin.flush()
        except OSError as error:
            raise WorkerError(f'{self._module} has ended') from error

    def receive(self, timeout: float) -> Any:
        """The result of the call before. Raises WorkerError after `timeout` (s), or where the call failed."""
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], timeout)[0]:
            raise WorkerError(f'{self._module} does not answer')
        line = self._process.stdout.readline()
        if not line:
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


def serve(functions: Mapping[str, Callable[..., Any]]) -> None:
    """Answer calls by name until standard input is closed: the body of a worker's `main`."""
    for line in sys.stdin:
        name, arguments = json.loads(line)
        try:
            answer = {'result': functions[name](**arguments)}
        except Exception as error:  # noqa: BLE001  the program decides
            answer = {'error': f'{name}: {type(error).__name__}: {error}'}
        with suppress(BrokenPipeError):
            print(json.dumps(answer), flush=True)


def paced(seconds: float, rate: float, meanwhile: Callable[[], None] = lambda: None) -> Iterator[int]:
    """Numbers from 0, at a rate; after a delay as many at once as keep the rate.

    Parameters:
        seconds: duration.
        rate (Hz): of the numbers.
        meanwhile: called in each pause.
    """
    begun, done = time.monotonic(), 0
    while (elapsed := time.monotonic() - begun) < seconds:
        due = min(int(elapsed * rate), done + max(int(rate), 1))
        while done < due and time.monotonic() - begun < seconds:
            yield done
            done += 1
        meanwhile()
        time.sleep(STEP_S)
