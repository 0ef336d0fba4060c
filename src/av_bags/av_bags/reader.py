"""Reads bags: mcap or sqlite3, a file or rosbag2's folder, from here or from elsewhere, whole or damaged."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

from rclpy.serialization import deserialize_message
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore
from rosidl_runtime_py.utilities import get_message

from av_bags.definitions import AUDIO_COMMON, installed, parse
from av_bags.errors import BagError
from av_bags.salvage import salvage

MAGICS = {'mcap': b'\x89MCAP0\r\n', 'sqlite3': b'SQLite format 3\x00', 'ros1': b'#ROSBAG V'}
SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
FOREVER = 2**63 - 1
Row = tuple[str, int, bytes]  # topic, time in ns, message in CDR


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: `kind` is its messages' type."""

    name: str
    kind: str
    count: int


class Bag:
    """A bag to read. Raises BagError that names the bag and what is wrong with it.

    Of a damaged bag everything that can be read is copied to the system's temporary folder first; `problems` says what
    is missing, also after reading. Times are in ns.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).expanduser()
        self._problems: dict[str, None] = {}
        self._opened = ExitStack()
        try:
            self._readers = [(part, self._open(part)) for part in _parts_of(self.path)]
        except BaseException as error:
            self._opened.close()
            if isinstance(error, BagError) or not isinstance(error, Exception):
                raise
            raise BagError(f'{self.path} cannot be read: {error}') from error  # whatever a library makes of broken bytes
        self._readers.sort(key=lambda part: part[1].start_time)
        connections = [c for _, reader in self._readers for c in reader.connections if self._is_readable(c)]
        counts = Counter({c.topic: 0 for c in connections})
        for connection in connections:
            counts[connection.topic] += connection.msgcount
        self.topics = {c.topic: Topic(c.topic, c.msgtype, counts[c.topic]) for c in connections}
        self._definitions = {c.msgtype: c.msgdef for c in connections if c.msgdef.format != MessageDefinitionFormat.NONE}
        if not any(topic.count for topic in self.topics.values()):
            self._opened.close()
            raise BagError(f'{self.path}: the bag holds no messages ({"; ".join(self.problems) or "it is intact"})')
        self.start_ns = min(reader.start_time for _, reader in self._readers)
        self.end_ns = max(reader.end_time for _, reader in self._readers) - 1

    @property
    def problems(self) -> list[str]:
        """What is damaged or left out, as far as it has shown."""
        return list(self._problems)

    def messages(self, topics: Collection[str] | None = None, start_ns: int = 0, stop_ns: int = FOREVER) -> Iterator[Row]:
        """Topic, time and CDR of each message of `topics` (all by default) from `start_ns` until before `stop_ns`, by time."""
        for part, reader in self._readers:
            reached = start_ns - 1
            try:
                for row in self._rows(reader, topics, start_ns, stop_ns):
                    reached = row[1]
                    yield row
            except Exception as error:  # noqa: BLE001  whatever a library makes of broken bytes
                if part.suffix == '.mcap' and reader.path == part:
                    yield from self._rows(self._open_damaged(part), topics, reached + 1, stop_ns)
                else:
                    self._problems[f'damaged after {1e-9 * (reached - self.start_ns):.1f} s ({error})'] = None

    def definition(self, topic: str) -> str:
        """How the bag itself defines a topic's messages (ros2msg), empty where it does not."""
        text = self._definitions.get(self.topics[topic].kind)
        return text.data if text is not None and text.format == MessageDefinitionFormat.MSG else ''

    def decode(self, topic: str, data: bytes) -> Any:
        """The message as the bag defines it, in a class of rosbags. Raises BagError when the bytes are no such message."""
        kind = self.topics[topic].kind
        if kind not in self.types.fielddefs:
            raise BagError(f'{self.path}: {topic} cannot be read, {kind} is defined neither in the bag nor here')
        try:
            return self.types.deserialize_cdr(data, kind)
        except Exception as error:
            raise BagError(f'{self.path}: a message of {topic} is no {kind}: {error}') from error

    def decoder(self, topic: str, fast: bool = False) -> Callable[[bytes], Any]:
        """What makes messages of a topic's bytes: objects of the installed class, or with `fast` of a class of rosbags.

        It raises BagError or RuntimeError for bytes that are no such message. A type of another package that the bag
        defines otherwise is read as the bag has it. Raises BagError when a type of the rig had other fields when the bag
        was recorded.
        """
        kind = self.topics[topic].kind
        other = [] if kind in AUDIO_COMMON else self._fields_that_differ(kind)
        if other and kind.startswith('av_interfaces/'):
            raise BagError(f'{self.path}: {topic} was recorded with another definition of {kind} than the installed '
                           f'one, which differs in {", ".join(other)}; use the release that recorded it')
        if fast or other or kind in AUDIO_COMMON:
            return partial(self.decode, topic)
        return partial(_deserialise, get_message(kind))

    def _fields_that_differ(self, kind: str) -> list[str]:
        """Names of the fields of a type or its parts that are others in the bag than installed."""
        text = self._definitions.get(kind)
        if text is None or text.format != MessageDefinitionFormat.MSG:
            return []
        here, there = ({name: set(fields) for name, (_, fields) in parse(kind, each).items()}
                       for each in (installed(kind), text))
        return sorted({f'{name.split("/")[-1]}.{field}' for name in here
                       for field, _ in here[name] ^ there.get(name, set())})

    @cached_property
    def types(self) -> Typestore:
        """The types as the bag defines them; those that it does not define, as they are installed here."""
        found: Typesdict = {}
        for kind in {topic.kind for topic in self.topics.values()}:
            with suppress(Exception):  # neither installed, nor defined in a way that rosbags can parse
                found.update(parse(kind, self._definitions.get(kind) or installed(kind)))
        store = get_typestore(Stores.EMPTY)
        store.register(found)
        return store

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def _open(self, path: Path) -> Reader:
        try:
            reader = Reader(path)
            reader.open()
        except Exception:
            if path.suffix != '.mcap':
                raise
            return self._open_damaged(path)
        self._opened.callback(reader.close)
        return reader

    def _open_damaged(self, path: Path) -> Reader:
        copy = Path(self._opened.enter_context(TemporaryDirectory(prefix='bag_')), path.name)
        self._problems.update(dict.fromkeys(salvage(path, copy)))
        reader = Reader(copy)
        reader.open()
        self._opened.callback(reader.close)
        return reader

    def _rows(self, reader: Reader, topics: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[Row]:
        wanted = [c for c in reader.connections if c.topic in self.topics and (topics is None or c.topic in topics)]
        if wanted:  # none means all of them to rosbags
            for connection, time_ns, data in reader.messages(wanted, start_ns, stop_ns):
                yield connection.topic, time_ns, data

    def _is_readable(self, connection: Connection) -> bool:
        encoding = connection.ext.serialization_format if isinstance(connection.ext, ConnectionExtRosbag2) else ''
        if encoding != 'cdr':
            self._problems[f'{connection.topic}: messages in {encoding!r} are not read'] = None
        return encoding == 'cdr'

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()


def _deserialise(kind: type, data: bytes) -> Any:
    return deserialize_message(data, kind)


def _parts_of(path: Path) -> list[Path]:
    """What rosbags is to open: files, or a folder by its metadata.yaml. Raises BagError for what is no bag."""
    if not path.exists():
        raise BagError(f'{path}: no such bag')
    if not path.is_dir():
        _check_kind(path)
        return [path]
    metadata = path / 'metadata.yaml'
    described = metadata.is_file()
    compressed = described and re.search(r'^\s*compression_mode:\s*["\']?(file|message)', metadata.read_text(), re.I | re.M)
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
    """Raises BagError when a file is no bag."""
    with path.open('rb') as file:
        head = file.read(16)
    kind = next((kind for kind, magic in MAGICS.items() if head.startswith(magic)), None)
    if not head:
        raise BagError(f'{path} is empty: 0 bytes')
    if kind == 'ros1':
        raise BagError(f'{path} is a bag of ROS 1; convert it with: rosbags-convert --src {path} --dst FOLDER')
    if kind is None or kind != SUFFIXES.get(path.suffix):
        what = f'its content is {kind}' if kind else 'its content is neither mcap nor sqlite3'
        raise BagError(f'{path} is no bag: {what}, expected a .mcap or .db3 file or a folder of them')
