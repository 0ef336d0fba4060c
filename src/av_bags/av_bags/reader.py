"""Reads bags: mcap or sqlite3, single files or the folders of rosbag2, including damaged files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from av_bags.decompression import limit_rosbags
from av_bags.definitions import AUDIO_COMMON, definition, installed, parse
from av_bags.errors import BagError
from av_bags.salvage import salvage
from av_common.files import check_file, one_line, read_text

MAGICS = {'mcap': b'\x89MCAP0\r\n', 'sqlite3': b'SQLite format 3\x00', 'ros1': b'#ROSBAG V'}
SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
FOREVER = 2**63 - 1
# Fields that releases added to the rig's messages; bags without them are read (`converters`), and their values are unknown.
ADDED_FIELDS = frozenset({'Doa.drone_probability', 'Doa.fundamental', 'Doa.fundamental_variance',
                          'Track.identity_probability', 'Track.fundamental'})
Row = tuple[str, int, bytes]  # topic, time in ns, message in CDR
limit_rosbags()


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Parameters:
        name: absolute name of the topic.
        kind: type of its messages, 'package/msg/Type'.
        count: number of messages.
    """

    name: str
    kind: str
    count: int


class Bag(AbstractContextManager['Bag']):
    """A bag that is open for reading. Times are in ns.

    The readable messages of a damaged mcap file are first copied to the system's temporary folder.

    Parameters:
        path: an mcap or sqlite3 file, or a folder of rosbag2.

    Attributes:
        topics: the topics in CDR encoding, by name.
        start_ns, end_ns (ns): times of the first and of the last message.

    Raises BagError with the path and the reason for what is not a readable bag.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).expanduser()
        self._problems: dict[str, None] = {}
        self._opened = ExitStack()
        try:
            self._readers = sorted(map(self._open, _parts_of(self.path)), key=lambda reader: reader.start_time)
        except BaseException as error:
            self._opened.close()
            if isinstance(error, BagError) or not isinstance(error, Exception):
                raise
            raise BagError(f'{self.path} cannot be read: {one_line(error)}') from error  # libraries raise any type
        connections = [c for reader in self._readers for c in reader.connections if self._is_readable(c)]
        counts: Counter[str] = Counter()
        for connection in connections:
            counts[connection.topic] += connection.msgcount
        self.topics = {c.topic: Topic(c.topic, c.msgtype, counts[c.topic]) for c in connections}
        self._definitions = {c.msgtype: c.msgdef for c in connections if c.msgdef.format != MessageDefinitionFormat.NONE}
        if not counts.total():
            self._opened.close()
            raise BagError(f'{self.path}: the bag holds no messages ({"; ".join(self.problems) or "it is intact"})')
        self.start_ns = min(reader.start_time for reader in self._readers)
        self.end_ns = max(reader.end_time for reader in self._readers) - 1

    @property
    def problems(self) -> list[str]:
        """Damaged or omitted parts that reading has found until now."""
        return list(self._problems)

    def messages(self, topics: Collection[str] | None = None, start_ns: int = 0, stop_ns: int = FOREVER) -> Iterator[Row]:
        """Topic, time and CDR bytes of messages, in order of time.

        Parameters:
            topics: names of the topics to read; None for all.
            start_ns, stop_ns (ns): first time to read, and the time before which reading ends.
        """
        for reader in self._readers:
            reached = start_ns - 1
            try:
                for row in self._rows(reader, topics, start_ns, stop_ns):
                    reached = row[1]
                    yield row
            except Exception as error:  # noqa: BLE001  libraries raise any type on damaged bytes
                if reader.path.suffix == '.mcap':
                    yield from self._rows(self._open(reader.path, damaged=True), topics, reached + 1, stop_ns)
                else:
                    self._problems[f'damaged after {1e-9 * (reached - self.start_ns):.1f} s ({error})'] = None

    def definition(self, topic: str) -> str:
        """The bag's own definition (ros2msg) of a topic's messages; empty when it holds none in this format."""
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
        if kind not in self.types.fielddefs:
            raise BagError(f'{self.path}: {topic} cannot be read, {kind} is defined neither in the bag nor here')
        try:
            return self.types.deserialize_cdr(data, kind)
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
        different = self._different_fields(topic)
        refused = [name for name in different if name not in ADDED_FIELDS]
        if refused and kind.startswith('av_interfaces/'):
            raise BagError(f'{self.path}: {topic} was recorded with another definition of {kind} than the installed '
                           f'one, which differs in {", ".join(refused)}; use the release that recorded it')
        if fast or different or kind in AUDIO_COMMON:
            return partial(self.decode, topic)
        from rclpy.serialization import deserialize_message  # a bag is read without ROS, too
        from rosidl_runtime_py.utilities import get_message
        installed_class = get_message(kind)
        return lambda data: deserialize_message(data, installed_class)

    def is_older(self, topic: str) -> bool:
        """Whether the messages of a topic lack a field of ADDED_FIELDS."""
        return not ADDED_FIELDS.isdisjoint(self._different_fields(topic))

    def _different_fields(self, topic: str) -> list[str]:
        """Names of the fields of a topic's type, or of its parts, that differ between bag and installation."""
        kind, text = self.topics[topic].kind, self.definition(topic)
        if not text or kind in AUDIO_COMMON:
            return []
        here, there = ({name: set(fields) for name, (_, fields) in get_types_from_msg(each, kind).items()}
                       for each in (definition(kind), text))
        return sorted({f'{name.split("/")[-1]}.{field}' for name in here
                       for field, _ in here[name] ^ there.get(name, set())})

    @cached_property
    def types(self) -> Typestore:
        """The types as the bag defines them; types without a definition in the bag as installed."""
        found: Typesdict = {}
        for kind in {topic.kind for topic in self.topics.values()}:
            with suppress(Exception):  # neither installed, nor defined in a form that rosbags can parse
                found.update(parse(kind, self._definitions.get(kind) or installed(kind)))
        store = get_typestore(Stores.EMPTY)
        store.register(found)
        return store

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, path: Path, damaged: bool = False) -> Reader:
        """Open a file or folder, or the salvaged copy of a damaged mcap file."""
        source = path
        if damaged:
            source = Path(self._opened.enter_context(TemporaryDirectory(prefix='bag_')), path.name)
            self._problems.update(dict.fromkeys(salvage(path, source)))
        try:
            reader = Reader(source)
            reader.open()
        except Exception:
            if damaged or path.suffix != '.mcap':
                raise
            return self._open(path, damaged=True)
        self._opened.callback(reader.close)
        return reader

    def _rows(self, reader: Reader, topics: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[Row]:
        wanted = [c for c in reader.connections if c.topic in self.topics and (topics is None or c.topic in topics)]
        if wanted:  # rosbags takes an empty list for all connections
            for connection, time_ns, data in reader.messages(wanted, start_ns, stop_ns):
                yield connection.topic, time_ns, data

    def _is_readable(self, connection: Connection) -> bool:
        encoding = connection.ext.serialization_format if isinstance(connection.ext, ConnectionExtRosbag2) else ''
        if encoding != 'cdr':
            self._problems[f'{connection.topic}: messages in {encoding!r} are not read'] = None
        return encoding == 'cdr'


def _parts_of(path: Path) -> list[Path]:
    """The paths to open with rosbags: files, or a folder with metadata.yaml. Raises BagError when there is no bag."""
    if not path.exists():
        raise BagError(f'{path}: no such bag')
    if not path.is_dir():
        check_file(path)
        _check_kind(path)
        return [path]
    metadata = path / 'metadata.yaml'
    described = metadata.is_file()
    compressed = described and re.search(r'^\s*compression_mode:\s*["\']?(file|message)', read_text(metadata), re.I | re.M)
    files = [] if compressed else sorted(path.glob('*.mcap'))
    if files or described:
        return files or [path]
    databases = sorted(path.glob('*.db3'))
    if not databases:
        raise BagError(f'{path} is no bag: a folder without metadata.yaml, .mcap or .db3')
    if len(databases) > 1:
        raise BagError(f'{path} has several databases but no metadata.yaml; make one with: ros2 bag reindex {path}')
    return databases


def _check_kind(path: Path) -> None:
    """Raise BagError when a file is not a bag of ROS 2."""
    with path.open('rb') as file:
        head = file.read(16)
    kind = next((kind for kind, magic in MAGICS.items() if head.startswith(magic)), None)
    if not head:
        raise BagError(f'{path} is empty: 0 bytes')
    if kind == 'ros1':
        raise BagError(f'{path} is a bag of ROS 1; convert it with: rosbags-convert --src {path} --dst FOLDER')
    if kind is None or kind != SUFFIXES.get(path.suffix):
        content = kind or 'neither mcap nor sqlite3'
        raise BagError(f'{path} is no bag: its content is {content}, expected a .mcap or .db3 file or a folder of them')
