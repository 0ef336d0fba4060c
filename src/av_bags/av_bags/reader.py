"""Reads bags: mcap or sqlite3, a file or rosbag2's folder, from here or from elsewhere, whole or damaged."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType

from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from av_bags.definitions import learn, rig_types
from av_bags.errors import BagError
from av_bags.mcap_source import McapSource, Row

MAGICS = {'mcap': b'\x89MCAP0\r\n', 'sqlite3': b'SQLite format 3\x00', 'ros1': b'#ROSBAG V'}
SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
FOREVER = 2**63 - 1
# A lump of messages needs no more memory than about this.
LUMP_BYTES = 8 * 2**20


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: `kind` is its messages' type."""

    name: str
    kind: str
    count: int


class Bag:
    """A bag to read. Raises BagError that names the bag and what is wrong with it.

    A damaged bag opens as far as it can be read; `problems` says what is missing, also after reading. Times are in ns.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).expanduser()
        files = _mcap_files(self.path)
        try:
            self._source: _Mcap | _Rosbags = _Mcap(files) if files else _Rosbags(_database(self.path))
        except BagError:
            raise
        except Exception as error:  # whatever a library makes of broken bytes
            raise BagError(f'{self.path} cannot be read: {error}') from error
        self.topics = {topic.name: topic for topic in self._source.topics}
        self._problems: list[str] = []
        if not any(topic.count for topic in self.topics.values()):
            raise BagError(f'{self.path}: the bag holds no messages ({"; ".join(self.problems) or "it is intact"})')

    @property
    def problems(self) -> list[str]:
        """What is damaged or left out, as far as it has shown."""
        return [*self._source.problems, *self._problems]

    @property
    def start_ns(self) -> int:
        """Time of the first message."""
        return self._source.start_ns

    @property
    def end_ns(self) -> int:
        """Time of the last message."""
        return self._source.end_ns

    def messages(self, topics: Collection[str] | None = None, start_ns: int = 0,
                 stop_ns: int = FOREVER) -> Iterator[Row]:
        """Topic, time and CDR of each message of `topics` (all by default), in order of time."""
        for lump in self.lumps(topics, start_ns, stop_ns):
            yield from lump

    def lumps(self, topics: Collection[str] | None = None, start_ns: int = 0,
              stop_ns: int = FOREVER, least: int = 1) -> Iterator[list[Row]]:
        """The same, as many at a time as are at hand, but at least so many or LUMP_BYTES of them, except for the last."""
        reached, lump, size = start_ns, [], 0
        try:
            for rows in self._source.lumps(topics or self.topics, start_ns, stop_ns):
                lump += rows
                size += sum([len(data) for _, _, data in rows])
                if len(lump) >= least or size >= LUMP_BYTES:
                    reached, ready, lump, size = lump[-1][1], lump, [], 0
                    yield ready
        except Exception as error:  # noqa: BLE001  whatever a library makes of broken bytes
            reached = lump[-1][1] if lump else reached
            self._problems.append(f'damaged after {1e-9 * (reached - self.start_ns):.1f} s ({error})')
        if lump:
            yield lump

    def definition(self, topic: str) -> str:
        """How the bag itself defines a topic's messages (ros2msg), empty where it does not."""
        text = self._source.definitions.get(self.topics[topic].kind)
        return text.data if text is not None and text.format == MessageDefinitionFormat.MSG else ''

    def decode(self, topic: str, data: bytes) -> object:
        """The message with its fields as attributes. Raises BagError when the bytes are not of the topic's type."""
        kind = self.topics[topic].kind
        if kind not in self.types.fielddefs:
            raise BagError(f'{self.path}: {topic} cannot be read, {kind} is defined neither in the bag nor here')
        try:
            return self.types.deserialize_cdr(data, kind)
        except (SerdeError, ValueError) as error:
            raise BagError(f'{self.path}: a message of {topic} is no {kind}: {error}') from error

    def is_as_installed(self, topic: str) -> bool:
        """Whether a topic's messages are what their type is here."""
        kind, here = self.topics[topic].kind, rig_types()
        return self.types is here or (kind in self.types.fielddefs and kind in here.fielddefs
                                      and self.types.hash_rihs01(kind) == here.hash_rihs01(kind))

    @cached_property
    def types(self) -> Typestore:
        """The types as the bag defines them; those that it does not define, as they are installed here."""
        defined: dict = {}
        for name, text in self._source.definitions.items():
            with suppress(Exception):  # a definition that rosbags cannot parse is taken from here
                defined.update(_parse(name, text))
        for topic in self.topics.values():
            with suppress(ValueError):
                learn(topic.kind)
        installed = rig_types()
        if all(installed.fielddefs.get(name) == fields for name, fields in defined.items()):
            return installed  # as of a bag made here: making the types again takes long
        types = get_typestore(Stores.EMPTY)
        types.register({**installed.fielddefs, **defined})
        return types

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()


class _Mcap:
    """A bag of mcap files, one after the other in time; messages of other encodings than CDR are left out."""

    def __init__(self, files: list[Path]) -> None:
        self._parts = sorted((McapSource(file) for file in files), key=lambda part: part.start_ns)
        self._left_out: list[str] = []
        self.start_ns = min(part.start_ns for part in self._parts)
        self.end_ns = max(part.end_ns for part in self._parts)
        self.definitions: dict[str, MessageDefinition] = {}
        counts: dict[tuple[str, str], int] = {}
        for part in self._parts:
            for number, channel in part.channels.items():
                schema = part.schemas.get(channel.schema_id)
                if channel.message_encoding != 'cdr' or schema is None:
                    self._left_out.append(f'{channel.topic}: messages in {channel.message_encoding!r} are not read')
                    continue
                key = (channel.topic, schema.name)
                counts[key] = counts.get(key, 0) + part.counts.get(number, 0)
                form = MessageDefinitionFormat.MSG if schema.encoding == 'ros2msg' else MessageDefinitionFormat.IDL
                self.definitions[schema.name] = MessageDefinition(form, schema.data.decode(errors='replace'))
        self.topics = [Topic(name, kind, count) for (name, kind), count in counts.items()]

    @property
    def problems(self) -> list[str]:
        """What is damaged or left out, as far as it has shown."""
        return [problem for part in self._parts for problem in part.problems] + self._left_out

    def lumps(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[list[Row]]:
        known = {topic.name for topic in self.topics}
        for part in self._parts:
            names = {number: channel.topic for number, channel in part.channels.items()
                     if channel.topic in topics and channel.topic in known}
            yield from part.lumps(names, start_ns, stop_ns)

    def close(self) -> None:
        """Nothing is open."""


class _Rosbags:
    """A bag that rosbags reads: sqlite3, and what rosbag2 compressed by file or message."""

    def __init__(self, path: Path) -> None:
        self._reader = Reader(path)
        self._reader.open()
        self._connections: list[Connection] = list(self._reader.connections)
        self.start_ns = self._reader.start_time
        self.end_ns = self._reader.end_time - 1
        self.topics = [Topic(c.topic, c.msgtype, c.msgcount) for c in self._connections]
        self.definitions = {c.msgtype: c.msgdef for c in self._connections
                            if c.msgdef.format != MessageDefinitionFormat.NONE}
        self.problems: list[str] = []

    def lumps(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[list[Row]]:
        wanted = [c for c in self._connections if c.topic in topics]
        if wanted:
            for connection, time_ns, data in self._reader.messages(wanted, start_ns, stop_ns):
                yield [(connection.topic, time_ns, data)]

    def close(self) -> None:
        self._reader.close()


def _mcap_files(path: Path) -> list[Path]:
    """The mcap files of a bag, none when it is of another kind. Raises BagError for what is no bag."""
    if not path.exists():
        raise BagError(f'{path}: no such bag')
    if not path.is_dir():
        return [path] if _checked_kind(path) == 'mcap' else []
    files = sorted(path.glob('*.mcap'))
    metadata = path / 'metadata.yaml'
    if metadata.is_file():
        compressed = re.search(r'^\s*compression_mode:\s*["\']?(file|message)', metadata.read_text(), re.I | re.M)
        return [] if compressed else files
    if not files and not any(path.glob('*.db3')):
        raise BagError(f'{path} is no bag: a folder without metadata.yaml, .mcap or .db3')
    return files


def _database(path: Path) -> Path:
    """What rosbags is to read: a folder only with its metadata.yaml. Raises BagError where that is needed."""
    if not path.is_dir() or (path / 'metadata.yaml').is_file():
        return path
    files = sorted(path.glob('*.db3'))
    if len(files) > 1:
        raise BagError(f'{path} has several databases but no metadata.yaml; make one with: ros2 bag reindex {path}')
    return files[0]


def _checked_kind(path: Path) -> str:
    """The kind of a bag's file. Raises BagError for what is none."""
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
    return kind


def _parse(name: str, text: MessageDefinition) -> dict:
    if text.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text.data, name)
    separator = '=' * 80 + '\n'
    found: dict = {}
    for part in text.data.split(separator):
        if part.strip():
            found.update(get_types_from_idl(part.split('\n', 1)[1] if part.startswith('IDL: ') else part))
    return found
