"""Writes a bag in the background, so that a slow disk never holds up who listens."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

from av_bags.metadata import DEFAULT_QOS, TopicQos
from av_bags.writer import BagWriter

Encoder = Callable[[bytes], bytes | memoryview]
# A killed process loses what came since the last write, a loss of power what came since the last sync.
WRITE_PERIOD_S = 0.25
SYNC_PERIODS = 4


class Recording:
    """Takes messages from any thread and writes them to a bag of its own thread, several times a second.

    While the disk is full or slow, up to `queue_bytes` wait in memory; what comes beyond is dropped and counted, and
    the recording goes on when there is room again. `problem` says what is wrong with the disk now, `complaint` what
    was wrong with the last message that could not be encoded; both are empty when all is well.
    """

    def __init__(self, path: str | Path, compression: str = 'lz4', queue_bytes: int = 64_000_000) -> None:
        """Create the bag. Raises BagError."""
        self._bag = BagWriter(path, compression)
        self._queue_bytes = queue_bytes
        self._queue: deque[tuple[str, int, bytes]] = deque()
        self._queued = 0
        self._encoders: dict[str, Encoder] = {}
        self.dropped = 0
        self.problem = self.complaint = ''
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name='write bag', daemon=True)
        self._thread.start()

    @property
    def file(self) -> Path:
        """Where it goes."""
        return self._bag.file

    @property
    def counts(self) -> dict[str, int]:
        """Messages written of each topic."""
        return self._bag.counts

    @property
    def bytes_written(self) -> int:
        """Size so far."""
        return self._bag.bytes_written

    def add_topic(self, name: str, kind: str, qos: TopicQos = DEFAULT_QOS, encode: Encoder | None = None) -> None:
        """Announce a topic; `encode` (in the writing thread) turns each message into what is written.

        Raises UnknownTypeError.
        """
        with self._lock:
            self._bag.add_topic(name, kind, qos)
        if encode is not None:
            self._encoders[name] = encode

    def put(self, topic: str, time_ns: int, data: bytes) -> None:
        """Take a serialised message; returns at once."""
        if self._queued + self._bag.waiting + len(data) > self._queue_bytes:
            self.dropped += 1
            return
        self._queued += len(data)
        self._queue.append((topic, time_ns, data))

    def close(self) -> None:
        """Write what waits and finish the bag. Raises OSError when the disk refuses the rest."""
        self._closing.set()
        self._thread.join()
        try:
            self._drain()
        finally:
            self._bag.close()

    def _run(self) -> None:
        rounds = 0
        while not self._closing.wait(WRITE_PERIOD_S):
            rounds += 1
            try:
                self._drain()
                with self._lock:
                    self._bag.flush(sync=rounds % SYNC_PERIODS == 0)
                self.problem = ''
            except OSError as error:
                self.problem = f'{self.file} cannot be written: {error.strerror}'

    def _drain(self) -> None:
        for _ in range(len(self._queue)):
            topic, time_ns, data = self._queue.popleft()
            self._queued -= len(data)
            try:
                written = self._encoders[topic](data) if topic in self._encoders else data
            except ValueError as error:
                self.complaint = f'{topic}: {error}'
                self.dropped += 1
                continue
            with self._lock:
                self._bag.write(topic, time_ns, written)
