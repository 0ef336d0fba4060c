"""Reads bags: mcap or sqlite3, single files or the folders of rosbag2, including damaged files."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.records import McapRecord
from numpy.typing import NDArray
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from av_bags import timeline
from av_bags.decompression import ZSTD_MAGIC, limit_rosbags, message
from av_bags.definitions import AUDIO_PACKAGE, BagError, UnknownTypeError, completed, installed_types, parse
from av_bags.parts import Parts
from av_bags.timeline import MOST_STEPS, Segment
from av_common.files import one_line

FOREVER = 2**63 - 1  # ns, the largest time of a bag
NO_FIELD = 'structure_needs_at_least_one_member'    # that of a definition without fields, in rosbags and ROS
_IN_ADDRESSES = frozenset('?#%')
Row = tuple[str, int, bytes]  # topic, time in ns, message in CDR
limit_rosbags()


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Parameters:
        name: absolute name of the topic.
        kind: type of its messages, 'package/msg/Type'.
        count: number of messages.
        qos: what its publishers offered; none where the bag does not say.
    """

    name: str
    kind: str
    count: int
    qos: tuple[Qos, ...] = ()


class Bag(AbstractContextManager['Bag']):
    """A bag that is open for reading. Times are in ns.

    The files of a folder are merged by time. The readable messages of a damaged mcap file, and those of a file in whose course
    the clock was set back, are first copied to the system's temporary folder.

    Parameters:
        path: an mcap or sqlite3 file, or a folder of rosbag2.

    Attributes:
        topics: the topics in CDR encoding, by name.
        start_ns, end_ns (ns): times of the first and of the last message.
        notes: what was left out with reason, such as files that do not belong to the bag.

    Raises BagError with the path and the reason for what is not a readable bag.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).expanduser()
        self._problems: dict[str, None] = {}
        self._opened = ExitStack()
        self._copies: dict[Path, Reader] = {}    # of damaged files, each made once
        try:
            self._parts = parts = Parts(self.path, self._new_folder, self._open)
        except BaseException as error:
            self._opened.close()
            if isinstance(error, BagError) or not isinstance(error, Exception):
                raise
            raise BagError(f'{self.path} cannot be read: {one_line(error)}') from error  # libraries raise any type
        self.notes = list(parts.notes)
        self._problems.update(dict.fromkeys(parts.lost))
        self._readers = parts.readers
        connections = [c for reader in parts.readers for c in reader.connections if self._is_readable(c)]
        counts: Counter[tuple[str, str]] = Counter()
        for connection in connections:
            counts[connection.topic, _kind_of(connection)] += connection.msgcount
        offered = {c.topic: tuple(c.ext.offered_qos_profiles) for c in connections if isinstance(c.ext, ConnectionExtRosbag2)}
        most = {topic: Topic(topic, kind, count, offered[topic]) for (topic, kind), count in reversed(counts.most_common())}
        self.topics = {topic: most[topic] for topic, _ in counts}
        self._problems |= {f'{topic}: {count} messages of {kind} are not read, most are {self.topics[topic].kind}': None
                           for (topic, kind), count in counts.items() if kind != self.topics[topic].kind}
        self._stores: dict[str, Typestore] = {}
        self._definitions = {_kind_of(c): found for c in connections if (found := _usable(_kind_of(c), c.msgdef)) is not None}
        if not counts.total():
            self._opened.close()
            raise BagError(f'{self.path}: the bag holds no messages ({"; ".join(self.problems) or "it is intact"})')
        self.start_ns = min(reader.start_time for reader in self._readers)
        self.end_ns = max(reader.end_time for reader in self._readers) - 1

    @property
    def problems(self) -> list[str]:
        """Damaged or missing parts that reading has found until now."""
        return list(self._problems)

    @cached_property
    def segments(self) -> list[Segment]:
        """The parts of the bag between which the clock was set or nothing was recorded, in order of recording."""
        return self._timeline[1]

    @cached_property
    def length(self) -> float:
        """Recorded time (s), that of all segments without what lies between them."""
        return 1e-9 * sum(segment.end_ns - segment.start_ns for segment in self.segments)

    def messages(self, topics: Collection[str] | None = None, start_ns: int = 0, stop_ns: int = FOREVER,
                 segment: Segment | None = None) -> Iterator[Row]:
        """Topic, time and CDR bytes of messages, in order of time, where the clock was set back in that of recording.

        Parameters:
            topics: names of the topics to read; None for all.
            start_ns, stop_ns (ns): first time to read, and the time before which reading ends.
            segment: the one to read; None for all.
        """
        readers, segments = self._timeline
        if segment is not None:
            start_ns, stop_ns = max(start_ns, segment.start_ns), min(stop_ns, segment.end_ns + 1)
        for step in [segment.step] if segment is not None else sorted({each.step for each in segments}):
            files = [self._rows_of(reader, topics, start_ns, stop_ns) for number, reader in readers if number == step]
            merged = heapq.merge(*files, key=itemgetter(1)) if len(files) > 1 else files[0]
            yield from merged if self._parts.described or len(files) == 1 else self._once(merged)

    def _rows_of(self, reader: Reader, topics: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[Row]:
        """Messages of a file, past damage."""
        reached = start_ns - 1
        try:
            for row in self._rows(reader, topics, start_ns, stop_ns):
                reached = row[1]
                yield row
        except Exception as error:  # noqa: BLE001  libraries raise any type on damaged bytes
            if reader.path.suffix == '.mcap':
                yield from self._rows(self._salvaged(Path(str(reader.path))), topics, reached + 1, stop_ns)
            else:
                self._problems[f'damaged after {1e-9 * (reached - self.start_ns):.1f} s ({error})'] = None

    def _once(self, rows: Iterable[Row]) -> Iterator[Row]:
        """Rows without those that two files hold, such as a file and its repaired copy."""
        now, seen, copies = -1, set[tuple[str, bytes]](), 0
        for topic, time_ns, data in rows:
            if time_ns != now:
                now, seen = time_ns, set()
            if (topic, data) in seen:
                copies += 1
                continue
            seen.add((topic, data))
            yield topic, time_ns, data
        if copies:
            self.notes = [*(note for note in self.notes if 'in two files' not in note),
                          f'{copies} messages are in two files of the folder and count once']

    def definition(self, topic: str) -> str:
        """The bag's own definition (ros2msg) of a topic's messages; empty when it holds none that can be read so."""
        text = self._definitions.get(self.topics[topic].kind)
        return text.data if text is not None and text.format == MessageDefinitionFormat.MSG else ''

    def decode(self, topic: str, data: bytes) -> Any:
        """Decode a message by the bag's own definition, to an object of a rosbags class.

        Parameters:
            topic: name of the topic.
            data: the message in CDR.

        Raises BagError when the type is not defined or the bytes do not match it.
        """
        kind = self.topics[topic].kind
        try:
            return self._types(kind).deserialize_cdr(data, kind)
        except UnknownTypeError as error:
            raise BagError(f'{self.path}: {topic} cannot be read, {kind} is defined neither in the bag nor here') from error
        except Exception as error:
            raise BagError(f'{self.path}: a message of {topic} is no {kind}: {error}') from error

    def decoder(self, topic: str, fast: bool = False) -> Callable[[bytes], Any]:
        """A function from CDR bytes to messages; it raises BagError or RuntimeError for bytes of another type.

        Messages are objects of the installed class. A type of another package that the bag defines differently is decoded
        by the bag's definition.

        Parameters:
            topic: name of the topic.
            fast: objects of a rosbags class instead, which takes a third of the time.

        Raises BagError when a type of av_interfaces had other fields at the time of recording.
        """
        kind = self.topics[topic].kind
        different = self.different_fields(topic)
        if different and kind.startswith('av_interfaces/'):
            raise BagError(f'{self.path}: {topic} was recorded with another definition of {kind} than the installed '
                           f'one, which differs in {", ".join(different)}; use the release that recorded it')
        if fast or different or kind.startswith(AUDIO_PACKAGE):
            return partial(self.decode, topic)
        from rclpy.serialization import deserialize_message  # a bag is read without ROS, too
        from rosidl_runtime_py.utilities import get_message
        installed_class = get_message(kind)
        return lambda data: deserialize_message(data, installed_class)

    def different_fields(self, topic: str) -> list[str]:
        """Names of the fields of a topic's type, or of its parts, that differ between bag and installation."""
        kind = self.topics[topic].kind
        if not self.definition(topic) or kind.startswith(AUDIO_PACKAGE):
            return []
        there = parse(kind, self._definitions[kind])
        return sorted({f'{name.split("/")[-1]}.{field}' for name, (_, fields) in installed_types(kind).items()
                       for field in {name for name, _ in fields} ^ {name for name, _ in there.get(name, (None, fields))[1]}})

    def _types(self, kind: str) -> Typestore:
        """A type and its parts as the bag defines that type; without a definition in the bag as installed.

        Each type has its own, since the definitions of two types may disagree about a part. Raises UnknownTypeError where it is
        neither installed, nor defined in a form that rosbags can parse.
        """
        if kind not in self._stores:
            text, store = self._definitions.get(kind), get_typestore(Stores.EMPTY)
            try:
                store.register(installed_types(kind) if text is None else completed(parse(kind, text)))
            except Exception:  # rosbags raises any type, such as for two fields of one name
                if text is None:
                    raise
                del self._definitions[kind]
                return self._types(kind)
            self._stores[kind] = store
        return self._stores[kind]

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    @cached_property
    def _timeline(self) -> tuple[list[tuple[int, Reader]], list[Segment]]:
        """The open files, each with the number of steps back of the clock before it, and the segments."""
        readers, blocks, before = [], [], 0
        for reader in self._readers:
            times, steps = self._times_of(reader)
            parts = [(copy, self._times_of(copy)[0]) for copy in self._by_step(reader)] if steps else [(reader, times)]
            readers += [(before + number, part) for number, (part, _) in enumerate(parts)]
            blocks += [(before + number, times) for number, (_, times) in enumerate(parts)]
            before += len(parts) - 1 if self._parts.described else 0    # the files of a described bag follow each other
        return readers, timeline.segments_of(blocks)

    def _times_of(self, reader: Reader) -> tuple[NDArray[np.int64], int]:
        """Times (n,) of the messages of a file, and how often the clock was set back in its course."""
        steps, found = timeline.Steps(), list[int]()
        try:
            for topic, time_ns in timeline.recorded(reader):
                steps.take(topic, time_ns)
                found.append(time_ns)
            return np.array(found, np.int64), steps.count if steps.count <= MOST_STEPS else 0
        except Exception:  # noqa: BLE001  a damaged index: the messages themselves, in order of time, tell of gaps
            return np.array([row[1] for row in self._rows_of(reader, None, 0, FOREVER)], np.int64), 0

    def _by_step(self, reader: Reader) -> list[Reader]:
        """Copies of an open file in whose course the clock was set back, one for each clock."""
        path, problems = Path(str(reader.path)), list[str]()
        records = (timeline.records_of_file(path, problems) if path.suffix == '.mcap'
                   else timeline.records_of_database(reader, problems))
        return self._copied(records, problems, f'{path.stem}.mcap', MOST_STEPS)

    def _salvaged(self, path: Path) -> Reader:
        """A copy of what can be read of a damaged mcap file."""
        if path not in self._copies:
            problems: list[str] = []
            self._copies[path], = self._copied(timeline.records_of_file(path, problems), problems, path.name, 0)
        return self._copies[path]

    def _copied(self, records: Iterable[McapRecord], problems: list[str], name: str, most_steps: int) -> list[Reader]:
        """Open copies of records, in whose course `problems` are found; the other parameters are those of `copy_in_order`."""
        copies = timeline.copy_in_order(records, self._new_folder() / name, most_steps)
        self._problems.update(dict.fromkeys(problems))
        return [self._opened_reader(copy) for copy in copies]

    def _open(self, path: Path) -> Reader:
        """Open a file, or the salvaged copy of a damaged mcap file."""
        try:
            reader = self._opened_reader(path)
            storage = reader.storage
            if isinstance(storage, McapReader) and storage.chunks and reader.message_count > sum(
                    sum(chunk.channel_count.values()) for chunk in storage.chunks):
                raise BagError('chunks without an index')    # whose messages rosbags would leave out
        except Exception:
            if path.suffix.lower() != '.mcap':
                raise
            reader = self._salvaged(path)
        return reader

    def _opened_reader(self, path: Path) -> Reader:
        suffix = path.suffix.lower()    # rosbags knows files by it, and opens databases by an address
        if suffix != path.suffix or (suffix == '.db3' and not _IN_ADDRESSES.isdisjoint(str(path))):
            link = self._new_folder() / f'bag{suffix}'
            link.symlink_to(path.absolute())
            path = link
        reader = Reader(path)
        reader.open()
        self._opened.callback(reader.close)
        return reader

    def _new_folder(self) -> Path:
        """A folder that exists as long as the bag is open."""
        return Path(self._opened.enter_context(TemporaryDirectory(prefix='bag_')))

    def _rows(self, reader: Reader, topics: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[Row]:
        wanted = [c for c in reader.connections if c.topic in self.topics and (topics is None or c.topic in topics)
                  and _kind_of(c) == self.topics[c.topic].kind]
        if wanted:  # rosbags takes an empty list for all connections
            for connection, time_ns, data in reader.messages(wanted, start_ns, stop_ns):
                try:
                    if not isinstance(data, bytes):    # a database may hold any type
                        raise ValueError(f'{type(data).__name__} instead of bytes')
                    content = message(data) if self._parts.by_message or data.startswith(ZSTD_MAGIC) else data
                except ValueError as error:
                    self._problems[f'{connection.topic}: messages are left out: {error}'] = None
                    continue
                yield connection.topic, time_ns, content

    def _is_readable(self, connection: Connection) -> bool:
        encoding = connection.ext.serialization_format if isinstance(connection.ext, ConnectionExtRosbag2) else ''
        kind = connection.msgtype
        why = f'in {encoding!r}' if encoding != 'cdr' else '' if '/' in kind else f'of type {kind!r}'
        if why:
            self._problems[f'{connection.topic}: messages {why} are not read'] = None
        return not why


def _kind_of(connection: Connection) -> str:
    """The type of a topic's messages; as ROS 1 and some programs write it, the part in the middle is missing."""
    package, *_, name = connection.msgtype.split('/')
    return connection.msgtype if connection.msgtype.count('/') > 1 else f'{package}/msg/{name}'


def _usable(kind: str, text: MessageDefinition) -> MessageDefinition | None:
    """A bag's definition of a type as rosbags can parse it; None where the bag holds none, or nothing that is one."""
    usable = text._replace(data=text.data.lstrip('\ufeff').replace('\r\n', '\n').replace('\r', '\n'))
    if text.format == MessageDefinitionFormat.NONE or not usable.data.strip():
        return None
    try:
        _, fields = parse(kind, usable)[kind]
    except Exception:  # noqa: BLE001  rosbags raises any type
        return None
    return usable if any(name != NO_FIELD for name, _ in fields) else None    # else comments only
