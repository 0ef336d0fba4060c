"""A thread that outlives its errors, and one with a bounded queue, which decouples slow processing from receiving."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar('Item')
MOST_WAITING = 2    # items
PAUSE_S = 0.1    # after an unexpected error, so that one that persists does not occupy the processor


def report(error: Exception) -> None:
    """Report an unexpected error as if it had ended the thread: by its traceback, and as a warning in tests."""
    threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, threading.current_thread())))


class Worker:
    """Calls a function repeatedly on a thread. Its errors are counted in `failed`.

    A ValueError is an invalid input. Each other new error is reported.

    Parameters:
        name: name of the thread.
        step: function without a long wait, since `stop` waits for it.
        pause (s): after an unexpected error.
    """

    def __init__(self, name: str, step: Callable[[], None], pause: float = PAUSE_S) -> None:
        self.failed = 0
        self.last_error = ''
        self._step, self._pause = step, pause
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Let the thread end after the present step, without waiting for it."""
        self._stopping = True

    def stop(self) -> None:
        """End the thread after the present step."""
        self.end()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping:
            try:
                self._step()
            except ValueError as error:
                self.failed += 1
                self.last_error = str(error)
            except Exception as error:  # noqa: BLE001 (whatever a datagram causes: the next one is processed)
                self.failed += 1
                if repr(error) != self.last_error:
                    self.last_error = repr(error)
                    report(error)
                time.sleep(self._pause)


class Consumer(Worker, Generic[Item]):
    """A worker for items from other threads.

    When the queue is full, the oldest item is dropped and counted in `dropped`, so that the newest is processed soon.

    Parameters:
        name: name of the thread.
        work: function that is called with each item, on the thread.
    """

    def __init__(self, name: str, work: Callable[[Item], None]):
        self.dropped = 0
        self._work = work
        self._items: deque[Item | None] = deque(maxlen=MOST_WAITING)
        self._filled = threading.Condition()
        super().__init__(name, self._take)

    def put(self, item: Item | None) -> None:
        """Append an item without blocking; None ends the thread."""
        with self._filled:
            self.dropped += len(self._items) == MOST_WAITING
            self._items.append(item)
            self._filled.notify()

    def stop(self) -> None:
        """End the thread after the waiting items."""
        self.put(None)
        self._thread.join()

    def _take(self) -> None:
        with self._filled:
            self._filled.wait_for(lambda: self._items)
            item = self._items.popleft()
        if item is None:
            self.end()
        else:
            self._work(item)
