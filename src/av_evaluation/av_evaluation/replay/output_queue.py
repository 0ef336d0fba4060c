"""The messages that a replay writes."""

from __future__ import annotations

from operator import itemgetter
from typing import Any

from av_bags import topics as names
from av_bags.definitions import serialiser
from av_bags.feed import SECOND
from av_bags.topics import absolute
from av_bags.writer import DEFAULT_QOS, LATCHED, BagWriter

BATCH = 1000


class OutputQueue:
    """Writes messages by the rig's names of their topics, some at a time in order of time. Raises OSError.

    Parameters:
        bag: to write to.
        namespace: of the topics.
    """

    def __init__(self, bag: BagWriter, namespace: str) -> None:
        self._bag, self._namespace = bag, namespace
        self._waiting: list[tuple[str, int, bytes]] = []

    def put(self, name: str, time: float, message: Any, data: bytes = b'') -> None:
        """Take a message of a time in s; `data` is the message in CDR where that is known."""
        self._waiting.append((name, round(time * SECOND), data or serialiser(names.KINDS[name][0])(message)))
        if len(self._waiting) >= BATCH:
            self.flush()

    def flush(self) -> None:
        """Write what was taken."""
        waiting, self._waiting = self._waiting, []
        for name, time_ns, data in sorted(waiting, key=itemgetter(1)):
            topic = absolute(name, self._namespace)
            if topic not in self._bag.counts:
                self._bag.add_topic(topic, names.KINDS[name][0], LATCHED if name == names.FRAMES else DEFAULT_QOS)
            self._bag.write(topic, time_ns, data)
