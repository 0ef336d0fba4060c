"""A thread that reads a camera and reopens it after it was unplugged."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import NDArray

from av_common.camera import PinholeCamera


class SourceError(RuntimeError):
    """A camera or file cannot be opened or read."""


@dataclass(frozen=True)
class CapturedImage:
    """An image with the data of its source.

    Parameters:
        pixels (h, w[, channels]): BGR uint8, or grey of 8 or 16 bits.
        time (s): time of capture, on the caller's clock.
        camera: intrinsics that the device reports.
        depth (h, w; mm): depth as uint16, aligned to the pixels.
    """

    pixels: NDArray
    time: float
    camera: PinholeCamera | None = None
    depth: NDArray | None = None


class Source(Protocol):
    """A camera. `open` and `read` raise SourceError; `read` waits for an image and returns None at the end of a file."""

    def open(self) -> None:
        """Begin to capture."""

    def read(self) -> CapturedImage | None:
        """The next image."""

    def close(self) -> None:
        """Stop; harmless when not open."""


class Capture:
    """Reads a source in a thread and opens it again after it was lost.

    Parameters:
        source: camera or file.
        deliver: function that is called with each image, in the thread.
        retry_s (s): pause before the source is opened again.
    """

    def __init__(self, source: Source, deliver: Callable[[CapturedImage], None], retry_s: float = 1.0) -> None:
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
            image = self._source.read()
            if image is None:
                self.finished = True
                return
            self.problem = ''
            self._deliver(image)
