"""A thread that outlives its errors."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

PAUSE_S = 0.1    # after an unexpected error, so that one that persists does not occupy the processor


def report(error: Exception) -> None:
    """Report an unexpected error as if it had ended the thread: by its traceback, and as a warning in tests."""
    threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, threading.current_thread())))


class Worker:
    """Calls a function repeatedly on a thread. Its errors are counted in `failed`, and each new one is reported.

    Parameters:
        name: name of the thread.
        step: function without a long wait, since `stop` waits for it.
    """

    def __init__(self, name: str, step: Callable[[], None]) -> None:
        self.failed = 0
        self.last_error = ''
        self._step = step
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread after the present step."""
        self._stopping = True
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping:
            try:
                self._step()
            except Exception as error:  # noqa: BLE001 (whatever a datagram causes: the next one is processed)
                self.failed += 1
                if repr(error) != self.last_error:
                    self.last_error = repr(error)
                    report(error)
                time.sleep(PAUSE_S)
