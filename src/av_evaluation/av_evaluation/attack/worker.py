"""Processes that attack, which leave this one to the observer, and what sends at a steady rate."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

STEP_S = 0.01    # between looks at what is due


class WorkerError(RuntimeError):
    """A process of the attack failed, or did not answer in time."""


class Worker:
    """An object in a process of its own.

    Parameters:
        make: makes the object there; a function of a module.
        log: file to which is appended what the process says; the middleware says much.
    """

    def __init__(self, make: Callable[[], object], log: Path) -> None:
        self._pool = ProcessPoolExecutor(1, multiprocessing.get_context('spawn'), _start, (make, log))

    def call(self, method: str, timeout: float = 30.0, **arguments: Any) -> Any:
        """Call a method of the object and wait for its result. Raises WorkerError after `timeout` (s), or where it fails."""
        try:
            return self._pool.submit(_call, method, arguments).result(timeout)
        except Exception as error:
            raise WorkerError(f'{type(error).__name__}: {error}') from error

    def close(self) -> None:
        """Let the process end, at the latest after its call."""
        self._pool.shutdown(wait=False, cancel_futures=True)


_served: object = None


def _start(make: Callable[[], object], log: Path) -> None:
    global _served
    with log.open('ab') as output:
        for descriptor in (1, 2):
            os.dup2(output.fileno(), descriptor)
    _served = make()


def _call(method: str, arguments: dict[str, Any]) -> Any:
    return getattr(_served, method)(**arguments)


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
