"""Writes bags in mcap format, readable by `ros2 bag`, Foxglove, PlotJuggler, rosbags and mcap."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import yaml
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v8

from av_bags.definitions import BagError, definition
from av_bags.retrying_file import RetryingFile, unnamed_file

COMPRESSION = CompressionType.LZ4    # of the chunks
CHUNK_BYTES = 512 * 1024  # before compression, of messages that are read at once
_EVER = QosTime(9223372036, 854775807)  # rmw's infinite duration
DEFAULT_QOS = Qos(QosHistory.UNKNOWN, 0, QosReliability.RELIABLE, QosDurability.VOLATILE, _EVER, _EVER,
                  QosLiveliness.AUTOMATIC, _EVER, False)
LATCHED = DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL)
COMMIT_BYTES = 64 * 1024  # of indexes, in memory before they are written


class ChunkIndexes:
    """Takes the place of the list in which `mcap.writer.Writer` collects a `ChunkIndex` of 2 kB for every chunk.

    The records wait in a file without a name, written as in the bag. While the disk refuses them, they wait in memory.

    Parameters:
        folder: of the bag.

    Raises OSError where no file can be created.
    """

    def __init__(self, folder: Path) -> None:
        self._file = unnamed_file(folder)
        self.close = self._file.close

    def append(self, index: ChunkIndex) -> None:
        """Add the index of a chunk."""
        builder = RecordBuilder()
        index.write(builder)
        self._file.write(builder.end())
        if self._file.waiting >= COMMIT_BYTES:
            with suppress(OSError):
                self._file.commit()

    def __iter__(self) -> Iterator[ChunkIndexes]:
        """All of them as one, which the writer asks to `write` itself."""
        yield self

    def write(self, builder: RecordBuilder) -> None:
        """Write all indexes."""
        builder.write(self._file.content())


class BagWriter(AbstractContextManager['BagWriter']):
    """One mcap file (https://mcap.dev/spec) of messages in CDR, with their definitions.

    The same messages always give the same file, byte by byte.

    Parameters:
        path: a name that ends in .mcap is the file itself; any other is a folder for the file and rosbag2's
            metadata.yaml. Missing parent folders are created.

    Attributes:
        file: path of the mcap file.
        counts: number of messages of each topic.

    Raises BagError when the path exists or cannot be created.
    """

    def __init__(self, path: str | Path) -> None:
        path = Path(path).expanduser()
        if path.exists():
            raise BagError(f'{path} exists already; choose another path or remove it')
        self._in_folder = path.suffix != '.mcap'
        self.file = path / f'{path.name}_0.mcap' if self._in_folder else path
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self._stream = RetryingFile(self.file.open('x+b', buffering=0))
            self._indexes = ChunkIndexes(self.file.parent)
        except OSError as error:
            raise BagError(f'{self.file} cannot be created: {error}') from error
        self._mcap = Writer(self._stream, CHUNK_BYTES, COMPRESSION)
        self._mcap._Writer__chunk_indices = self._indexes  # a list would grow by 8 kB a second
        self._mcap.start('ros2')
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._topics: dict[str, dict[str, str]] = {}
        self._span_ns: tuple[int, int] | None = None
        self.counts: dict[str, int] = {}

    @property
    def bytes_written(self) -> int:
        """Size of the file in bytes, including data that are not on the disk yet."""
        return self._stream.tell()

    @property
    def waiting(self) -> int:
        """Number of bytes that the disk has not accepted yet."""
        return self._stream.waiting

    def add_topic(self, name: str, kind: str, qos: Qos = DEFAULT_QOS, text: str = '') -> None:
        """Announce a topic.

        Parameters:
            name: absolute name of the topic.
            kind: type of its messages, 'package/msg/Type'.
            qos: quality of service that `ros2 bag play` will offer.
            text: definition (ros2msg) of the type; empty for the installed one.

        Raises UnknownTypeError when the definition is not installed.
        """
        if kind not in self._schemas:
            self._schemas[kind] = self._mcap.register_schema(kind, 'ros2msg', (text or definition(kind)).encode())
        profile = dump_qos_v8([qos])
        self._channels[name] = self._mcap.register_channel(name, 'cdr', self._schemas[kind],
                                                           {'offered_qos_profiles': profile})
        self._topics[name] = {'name': name, 'type': kind, 'serialization_format': 'cdr', 'offered_qos_profiles': profile}
        self.counts[name] = 0

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Append a message; it reaches the file with the next `flush` or when a chunk is full.

        Parameters:
            topic: an announced topic.
            time_ns (ns): time of recording.
            data: the message in CDR.

        Raises OSError when the disk refuses earlier messages; the message is kept nevertheless.
        """
        self._mcap.add_message(self._channels[topic], time_ns, data, time_ns, self.counts[topic])
        self.counts[topic] += 1
        first, last = self._span_ns or (time_ns, time_ns)
        self._span_ns = min(first, time_ns), max(last, time_ns)
        if self._stream.waiting:
            self._stream.commit()

    def flush(self, sync: bool = False) -> None:
        """Write all messages to the file, and with `sync` to the disk. Raises OSError; can then be repeated."""
        self._mcap._Writer__finalize_chunk()  # mcap has no public way to end a chunk early
        self._stream.commit()
        if sync:
            self._stream.sync()

    def close(self) -> None:
        """Finish the file. Raises OSError when the disk refuses its end; the messages before can still be read."""
        try:
            self._mcap.finish()
            self._stream.commit()
            if self._in_folder:
                self._describe()
        finally:
            self._stream.close()
            self._indexes.close()

    def _describe(self) -> None:
        """Write metadata.yaml in version 5, which every rosbag2 since Humble reads."""
        first, last = self._span_ns or (0, 0)
        count = sum(self.counts.values())
        file = {'path': self.file.name, 'starting_time': {'nanoseconds_since_epoch': first},
                'duration': {'nanoseconds': last - first}, 'message_count': count}
        content = {'rosbag2_bagfile_information': {
            'version': 5, 'storage_identifier': 'mcap', 'relative_file_paths': [self.file.name],
            'starting_time': {'nanoseconds_since_epoch': first}, 'duration': {'nanoseconds': last - first},
            'message_count': count, 'compression_format': '', 'compression_mode': '', 'files': [file],
            'topics_with_message_count': [{'topic_metadata': topic, 'message_count': self.counts[name]}
                                          for name, topic in self._topics.items()]}}
        self.file.with_name('metadata.yaml').write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')

    def __exit__(self, *_: object) -> None:
        self.close()
