"""A thread that works on what receivers hand over, so that they never wait for it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar('Item')


class Consumer(Generic[Item]):
    """A worker thread for items that receivers hand over.

    Older items are dropped and counted in `dropped`, failures (ValueError) in `failed`.

    Parameters:
        name: of the thread.
        work: called with each item, on the thread.
        depth: items that wait at most; the newest are kept.
    """

    def __init__(self, name: str, work: Callable[[Item], None], depth: int = 4):
        self.dropped = self.failed = 0
        self.complaint = ''
        self._work = work
        self._items: queue.Queue[Item | None] = queue.Queue(depth)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: Item | None) -> None:
        """Hand over an item; never waits."""
        while True:
            try:
                self._items.put_nowait(item)
                return
            except queue.Full:
                try:
                    self._items.get_nowait()
                    self.dropped += 1
                except queue.Empty:
                    pass

    def stop(self) -> None:
        """End the thread after what waits."""
        self.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (item := self._items.get()) is not None:
            try:
                self._work(item)
            except ValueError as error:
                self.failed += 1
                self.complaint = str(error)
