"""Writes a bag from a separate thread, so that a slow disk does not block subscribers."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

from rosbags.interfaces import Qos

from av_bags.writer import DEFAULT_QOS, BagWriter

Encoder = Callable[[bytes], bytes]
# A killed process loses the messages since the last write, a power failure those since the last sync.
WRITE_PERIOD_S = 0.25
SYNC_PERIODS = 4  # of writing: once a second


class BackgroundWriter:
    """Accepts messages from one thread and writes them to a bag from its own thread, several times a second.

    While the disk is full or slow, messages wait in memory up to `queue_bytes`. Further messages are dropped and
    counted. Writing resumes as soon as the disk accepts data.

    Parameters:
        path: path of the bag, as for BagWriter.
        queue_bytes (bytes): largest total size of waiting messages.

    Attributes:
        bag: the BagWriter.
        dropped, unencoded: numbers of messages that were lost because the disk was too slow, and as they could not be encoded.
        problem: current problem of the disk; empty without one.
        encoding_problem: why the last one could not be encoded; empty without one.

    Raises BagError where the path exists or cannot be created.
    """

    def __init__(self, path: str | Path, queue_bytes: int = 64_000_000) -> None:
        self.bag = BagWriter(path)
        self._queue_bytes = queue_bytes
        self._queue: deque[tuple[str, int, bytes]] = deque()
        self._put = self._taken = 0    # bytes until now; each is counted by one thread only
        self._encoders: dict[str, Encoder] = {}
        self.dropped = self.unencoded = 0
        self.problem = self.encoding_problem = ''
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name='write bag', daemon=True)
        self._thread.start()

    def add_topic(self, name: str, kind: str, qos: Qos = DEFAULT_QOS, encode: Encoder | None = None) -> None:
        """Announce a topic. Raises UnknownTypeError.

        Parameters:
            name, kind, qos: topic, type and quality of service, as for `BagWriter.add_topic`.
            encode: function that the writing thread applies to each message; None to write messages unchanged.
        """
        with self._lock:
            self.bag.add_topic(name, kind, qos)
        if encode is not None:
            self._encoders[name] = encode

    def put(self, topic: str, time_ns: int, data: bytes) -> None:
        """Queue a message without blocking.

        Parameters:
            topic: an announced topic.
            time_ns (ns): time of recording.
            data: the message in CDR, before encoding.
        """
        if self._put - self._taken + self.bag.waiting + len(data) > self._queue_bytes:
            self.dropped += 1
            return
        self._put += len(data)
        self._queue.append((topic, time_ns, data))

    def close(self) -> None:
        """Write the waiting messages and finish the bag. Raises OSError when the disk refuses them."""
        self._closing.set()
        self._thread.join()
        try:
            self._drain()
        finally:
            self.bag.close()

    def _run(self) -> None:
        rounds = 0
        while not self._closing.wait(WRITE_PERIOD_S):
            rounds += 1
            try:
                self._drain()
                with self._lock:
                    self.bag.flush(sync=rounds % SYNC_PERIODS == 0)
                self.problem = ''
            except OSError as error:
                self.problem = f'{self.bag.file} cannot be written: {error.strerror}'

    def _drain(self) -> None:
        for _ in range(len(self._queue)):
            topic, time_ns, data = self._queue.popleft()
            self._taken += len(data)
            try:
                encoded = self._encoders[topic](data) if topic in self._encoders else data
            except Exception as error:  # noqa: BLE001  whatever a message from outside makes an encoder raise
                self.encoding_problem = f'{topic}: {error}'
                self.unencoded += 1
                continue
            with self._lock:
                self.bag.write(topic, time_ns, encoded)
