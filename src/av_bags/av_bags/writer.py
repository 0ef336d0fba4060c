"""Writes bags that Foxglove, PlotJuggler, `ros2 bag play`, rosbags and mcap read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from av_bags.definitions import definition
from av_bags.errors import BagError
from av_bags.mcap_file import COMPRESSORS, McapFile, Message
from av_bags.metadata import (
    DEFAULT_QOS,
    TopicQos,
    TopicRecord,
    write_metadata,
)
from av_bags.retrying_file import PatientFile

CHUNK_BYTES = 512 * 1024


class BagWriter:
    """One mcap file (https://mcap.dev/spec) of messages in CDR, with their definitions.

    A path that ends in .mcap becomes that file, any other a folder with the file and rosbag2's metadata.yaml. Folders
    on the way are created; a path that exists is refused with a BagError. Equal messages make equal files.
    """

    def __init__(self, path: str | Path, compression: str = 'lz4') -> None:
        path = Path(path).expanduser()
        if path.exists():
            raise BagError(f'{path} exists already; choose another path or remove it')
        compression = compression.removeprefix('none')
        if compression not in COMPRESSORS:
            raise BagError(f'compression is {compression!r}, expected none, lz4 or zstd')
        self._in_folder = path.suffix != '.mcap'
        self.file = path / f'{path.name}_0.mcap' if self._in_folder else path
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self._stream = PatientFile(self.file)
        except OSError as error:
            raise BagError(f'{self.file} cannot be created: {error}') from error
        self._mcap = McapFile(self._stream, compression, CHUNK_BYTES)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._qos: dict[str, tuple[str, TopicQos]] = {}

    @property
    def counts(self) -> dict[str, int]:
        """Messages written of each topic."""
        return self._mcap.counts

    @property
    def bytes_written(self) -> int:
        """Size of the file, with what waits for the disk."""
        return self._stream.tell()

    @property
    def waiting(self) -> int:
        """Bytes that the disk has not taken yet."""
        return self._stream.waiting

    def add_topic(self, name: str, kind: str, qos: TopicQos = DEFAULT_QOS, text: str = '') -> int:
        """Announce a topic of messages 'package/msg/Type', defined by `text` (ros2msg) or as installed; returns its number.

        Raises UnknownTypeError when their package is missing.
        """
        if kind not in self._schemas:
            content = (text or definition(kind)).encode()
            self._schemas[kind] = self._mcap.add_schema(kind, 'ros2msg', content)
        metadata = {'offered_qos_profiles': qos.to_yaml()}
        self._channels[name] = self._mcap.add_channel(name, self._schemas[kind], metadata)
        self._qos[name] = (kind, qos)
        return self._channels[name]

    def write(self, topic: str, time_ns: int, data: bytes | memoryview) -> None:
        """Append a message of an announced topic; it reaches the file with the next `flush` at the latest.

        Raises OSError when the disk refuses earlier ones; the message is kept nevertheless.
        """
        self.write_many([(self._channels[topic], time_ns, data)])

    def write_many(self, messages: Sequence[Message]) -> None:
        """The same for messages of topics by their numbers, each with its time in ns."""
        if self._mcap.add_messages(messages):
            self._stream.commit()

    def flush(self, sync: bool = False) -> None:
        """Bring everything to the file, and with `sync` to the disk.

        Raises OSError; may then be called again, without loss.
        """
        self._mcap.end_chunks()
        self._stream.commit()
        if sync:
            self._stream.sync()

    def close(self) -> None:
        """Finish the file. Raises OSError when the disk refuses its end; what came before can still be read."""
        try:
            self._mcap.finish()
            self._stream.commit()
            if self._in_folder:
                records = [TopicRecord(name, *self._qos[name], count) for name, count in self.counts.items()]
                write_metadata(self.file, records, *self._mcap.span_ns)
        finally:
            self._stream.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()
