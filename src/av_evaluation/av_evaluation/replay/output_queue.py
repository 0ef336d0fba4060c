"""What a replay writes."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter

from av_bags import topics as names
from av_bags.mcap_file import Message
from av_bags.metadata import DEFAULT_QOS, LATCHED
from av_bags.topics import absolute
from av_bags.writer import BagWriter

SECOND = 10**9


class Outbox:
    """Collects messages by the rig's names of their topics, and writes many at once, in order of time."""

    def __init__(self, bag: BagWriter, namespace: str) -> None:
        self._bag, self._namespace = bag, namespace
        self._numbers: dict[str, int] = {}
        self._waiting: list[Message] = []

    def put(self, name: str, time: float, data: bytes | memoryview) -> None:
        """Take a message of a time in s."""
        if name not in self._numbers:
            self._announce(name)
        self._waiting.append((self._numbers[name], round(time * SECOND), data))

    def put_all(self, name: str, messages: Iterable[tuple[float, bytes]]) -> None:
        """Take messages of a topic, each with its time in s."""
        if name not in self._numbers:
            self._announce(name)
        number = self._numbers[name]
        self._waiting += [(number, round(time * SECOND), data) for time, data in messages]

    def flush(self) -> None:
        """Write what was taken. Raises OSError when the disk refuses it."""
        waiting, self._waiting = self._waiting, []
        waiting.sort(key=itemgetter(1))
        self._bag.write_many(waiting)

    def _announce(self, name: str) -> None:
        qos = LATCHED if name == names.FRAMES else DEFAULT_QOS
        self._numbers[name] = self._bag.add_topic(absolute(name, self._namespace), names.KINDS[name][0], qos)
