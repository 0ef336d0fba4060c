"""Worker thread with a bounded queue, which decouples slow processing from the receiving threads."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from av_sim_bridge.receiving.worker import report

Item = TypeVar('Item')


class Consumer(Generic[Item]):
    """A worker thread for items from other threads.

    When the queue is full, the oldest item is dropped and counted in `dropped`, so that the newest is processed soon. Items
    for which `work` raises an error are counted in `failed`; errors other than ValueError are reported, too.

    Parameters:
        name: name of the thread.
        work: function that is called with each item, on the thread.
        depth: maximum number of waiting items.
    """

    def __init__(self, name: str, work: Callable[[Item], None], depth: int = 2):
        self.dropped = self.failed = 0
        self.last_error = ''
        self._work = work
        self._items: queue.Queue[Item | None] = queue.Queue(depth)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: Item | None) -> None:
        """Append an item to the queue without blocking; None ends the thread."""
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
        """End the thread after the waiting items."""
        self.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (item := self._items.get()) is not None:
            try:
                self._work(item)
            except ValueError as error:
                self.failed += 1
                self.last_error = str(error)
            except Exception as error:  # noqa: BLE001 (the next item is processed)
                self.failed += 1
                if repr(error) != self.last_error:
                    self.last_error = repr(error)
                    report(error)
