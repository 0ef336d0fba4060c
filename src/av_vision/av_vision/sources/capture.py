"""A thread that reads a camera and outlives its unplugging."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import NDArray

from av_common.camera import PinholeCamera


class SourceError(RuntimeError):
    """A camera or file that cannot be opened or has stopped answering."""


@dataclass(frozen=True)
class Picture:
    """A picture, the time of its capture in s on the clock of the caller, and what came with it.

    `depth` is (h, w) uint16 in millimetres, `camera` what the device says of its lens.
    """

    image: NDArray
    time: float
    camera: PinholeCamera | None = None
    depth: NDArray | None = None


class Source(Protocol):
    """A camera. `open` and `read` raise SourceError; `read` waits for a picture and returns None at the end of a file."""

    def open(self) -> None:
        """Begin to capture."""

    def read(self) -> Picture | None:
        """The next picture."""

    def close(self) -> None:
        """Stop; harmless when not open."""


class Capture:
    """Reads a source in a thread and hands each picture to `deliver`; opens it again `retry_s` after it was lost."""

    def __init__(self, source: Source, deliver: Callable[[Picture], None], retry_s: float = 1.0) -> None:
        self.problem = ''
        self.finished = False
        self.reconnections = 0
        self._source = source
        self._deliver = deliver
        self._retry_s = retry_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='capture', daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the source."""
        self._stop.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while not self._stop.is_set() and not self.finished:
            try:
                self._source.open()
                self._read_all()
            except SourceError as error:
                self.problem = str(error)
                self.reconnections += 1
                self._stop.wait(self._retry_s)
            finally:
                self._source.close()

    def _read_all(self) -> None:
        while not self._stop.is_set():
            picture = self._source.read()
            if picture is None:
                self.finished = True
                return
            self.problem = ''
            self._deliver(picture)
